import json
import re
import tomllib
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import small_rig
from typer.testing import CliRunner

from drivers.errors import RecordingError
from drivers.factory import build_devices
from drivers.files.recording import RecordingSource, RecordingWriter
from drivers.files.rig_file import read_rig, write_rig
from drivers.gates.gpio import GpioGateSettings
from drivers.gates.modem_line import ModemLineSettings
from drivers.gates.serial_gate import SerialGateSettings
from pipeline.frames import Frame, FrameBundle, Trigger
from pipeline.measuring.volume_correction import VolumeModel
from pipeline.particle import PipelineParameters
from pipeline.rig.design import nominal_rig
from service.base.errors import SettingsError, VolumeModelError
from service.bundling.window import BundlingParameters
from service.commands.cli import build_app
from service.configuration.rig_checks import rig_warnings, timing_problems
from service.configuration.rig_settings import AravisRigSettings, CameraPlace
from service.configuration.settings import Settings, load_settings, problems, shortcomings
from service.configuration.volume_models import read_volume_model, write_volume_model
from service.delivery.settings import FileDropSettings, WebhookEndpoint
from service.store.keys import FILE, create_key, revoke_key
from service.web.settings import ApiKey, Scope

DEPLOY = Path(__file__).parents[4] / "deploy"

MINIMAL = """
[rig]
recording = "recording"
[spool]
dir = "spool"
[store]
dir = "/var/lib/somewhere"
"""

LIVE = (
    """
[rig]
backend = "aravis"
calibration = "rig.json"
[rig.gate.serial]
port = "gate"
"""
    + "".join(f'[[rig.cameras]]\nid = "c{i:02d}"\nserial = "SIM{i:04d}"\n' for i in range(1, 17))
    + """
[spool]
dir = "spool"
[store]
dir = "store"
"""
)


def settings_of(folder: Path, text: str) -> Settings:
    path = folder / "stonefall.toml"
    path.write_text(text)
    return load_settings(path)


def test_relative_paths_are_beside_the_file_and_absolute_ones_stay(tmp_path: Path, monkeypatch):
    monkeypatch.chdir("/")
    settings = settings_of(tmp_path, MINIMAL)
    assert settings.rig.recording == tmp_path / "recording"
    assert settings.rig.calibration_path == tmp_path / "recording/rig.json"
    assert settings.store.dir == Path("/var/lib/somewhere")


def test_a_linked_configuration_means_the_files_beside_the_target(tmp_path: Path):
    (tmp_path / "real").mkdir()
    settings_of(tmp_path / "real", MINIMAL)
    (tmp_path / "link.toml").symlink_to(tmp_path / "real/stonefall.toml")
    assert load_settings(tmp_path / "link.toml").rig.recording == tmp_path / "real/recording"


def test_every_parameter_of_the_pipeline_can_be_set(tmp_path: Path):
    # the source of the stones knows the fall, the daemon whether there is time
    given = {part.name for part in fields(PipelineParameters)} - {"fall", "is_rushed"}
    assert given < Settings.model_fields.keys()
    assert settings_of(tmp_path, MINIMAL).pipeline == PipelineParameters()
    pipeline = settings_of(tmp_path, MINIMAL + "[carving]\nn = 64\n[measuring]\ndensity_g_cm3 = 2.7").pipeline
    assert (pipeline.carving.n, pipeline.measuring.density_kg_m3) == (64, 2700.0)


@pytest.mark.parametrize(
    ("text", "complaints"),
    [
        (
            MINIMAL + "[carving]\nn = 'many'\n[api]\nport = 70000",
            ["carving.n: ", "api: port must be in 0..65535"],
        ),
        (MINIMAL + "[carvin]\nn = 64", ["carvin: "]),
        (MINIMAL + "[workers]\nslot = 2", ["workers.slot: "]),
        (MINIMAL + "[workers]\nslots = true", ["workers.slots: must be a number, not true"]),
        (
            LIVE.replace("[rig]", "[rig]\ndelay_outside_ms = true\ngain_db = false"),
            ["rig.delay_outside_ms: must be a number, not true", "rig.gain_db: must be a number, not false"],
        ),
        (MINIMAL + "[workers]\nslots = 0", ["workers: slots must be in 1..256, not 0"]),
        (MINIMAL + "[bundling]\nwindow_ms = 150", ["bundling: dead_time_ms must exceed twice window_ms"]),
        (MINIMAL + "keep_raw = -1", ["store: keep_raw must not be negative, not -1"]),
        (
            MINIMAL + "[store.retention]\nfiles_days = -1",
            ["store.retention: files_days must be in 0..36500, not -1"],
        ),
        (
            MINIMAL + "[store.retention]\nfiles_days = 9\nresults_days = 3",
            ["store.retention: files_days must not exceed results_days, 3, not 9"],
        ),
        (MINIMAL + "[store.retention]\nmax_gb = 9", ["store.retention.max_gb: "]),
        (MINIMAL.replace('dir = "spool"', ""), ["spool.dir: "]),
        (MINIMAL.replace("[rig]", "[rig]\nspeed = 0.0"), ["rig: speed must be in"]),
        (MINIMAL.replace("[rig]", '[rig]\npace = "fast"\nspeed = 2.0'), ["rig: speed scales"]),
        (MINIMAL.replace("[rig]", '[rig]\nbackend = "lidar"'), ["rig: ", "'replay', 'aravis'"]),
        (MINIMAL.replace("[rig]", '[rig]\nbackend = "aravis"'), ["rig.calibration: ", "rig.cameras: "]),
        (LIVE.replace("[rig]", "[rig]\nfall_height_mm = 0"), ["rig: fall_height_mm must be in"]),
        (LIVE.replace("[rig]", "[rig]\ndelay_correction_ms = -250"), ["rig: delay_correction_ms leaves a"]),
        (LIVE.replace("[rig]", '[rig]\ntrigger = "radio"'), ["rig: trigger must be a source"]),
        (LIVE.replace("[rig]", '[rig]\ntrigger = "Software"'), ['or "software" or "action", not']),
        (
            LIVE.replace('id = "c02"', 'id = "c02"\ntrigger = "in 1"'),
            ["rig: cameras: trigger of c02 must be a"],
        ),
        (
            LIVE.replace("[rig]", '[rig]\nstrobe_line = "Line2"').replace(
                'id = "c02"', 'id = "c02"\ntrigger = "Line2"'
            ),
            ["rig: strobe_line is an output: it cannot be Line2"],
        ),
        (
            LIVE.replace("[rig]", "[rig]\ndelay_outside_ms = 250"),
            ["rig: delay_outside_ms must be in 0..247.4"],
        ),
        (LIVE.replace("[rig]", "[rig]\nflash_us = 30"), ["rig: flash_us must be in 0.1..exposure_us"]),
        (LIVE.replace("[rig]", '[rig]\nstrobe_line = "Line1"'), ["rig: strobe_line is an output"]),
        (LIVE.replace("[rig]", "[rig]\npacket_size_bytes = 12000"), ["camera c01: packet_size_bytes"]),
        (LIVE.replace('id = "c02"', 'id = "c01"'), ["rig: cameras: id c01 is there twice"]),
        (LIVE.replace("SIM0002", "SIM0003"), ["rig: cameras: serial SIM0003 is there twice"]),
        (LIVE.replace('serial = "SIM0002"', ""), ["rig: cameras: camera c02: serial, address or user_name"]),
        (LIVE.replace("SIM0003", "1").replace('serial = "1"', "serial = 1"), ["rig.cameras.2.serial: "]),
        (LIVE + '[rig.gate.gpio]\nchip = "/dev/gpiochip0"\nline = 4\n', ["rig.gate: exactly one of"]),
        (LIVE.replace('port = "gate"', 'port = ""'), ["rig.gate.serial: port must be named"]),
        (LIVE + "[empty_rig]\nat_start = -1", ["empty_rig: at_start must be in"]),
        (MINIMAL + '[api]\nhost = ""', ["api: host must be an address or a host name, not ''"]),
        (MINIMAL + '[api]\nhost = "256.1.1.1"', ["api: host must be", "not '256.1.1.1'"]),
        (MINIMAL + '[api]\nallowed_hosts = ["a:80"]', ["api: allowed_hosts: must be", "not 'a:80'"]),
        (MINIMAL + '[api]\ntrusted_proxies = ["proxy"]', ["api: trusted_proxies: ", "'proxy'"]),
        (MINIMAL + f"[api]\nkeys = {5000 * '['}{5000 * ']'}", ["is nested too deeply"]),
        (MINIMAL + f"x = {2000 * '{a = '}1{2000 * '}'}", ["is nested too deeply"]),
        (MINIMAL + f"x = {5000 * '9'}", ["Exceeds the limit"]),
        (MINIMAL + "[api]\nkeys = [{name = 'mes', sha256 = 'secret'}]", ["api.keys.0: key 'mes'"]),
        ("[rig\n", ["line 1"]),
    ],
)
def test_every_wrong_field_is_named_with_the_file(tmp_path: Path, text: str, complaints: list[str]):
    with pytest.raises(SettingsError) as refused:
        settings_of(tmp_path, text)
    message = str(refused.value)
    assert message.startswith(f"{tmp_path}/stonefall.toml: ")
    for complaint in complaints:
        assert complaint in message


def test_a_missing_or_binary_file_is_refused(tmp_path: Path):
    with pytest.raises(SettingsError, match="No such file"):
        load_settings(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(SettingsError, match=r"binary\.toml"):
        load_settings(tmp_path / "binary.toml")


def test_a_line_that_takes_long_to_parse_is_refused(tmp_path: Path):
    """300 000 parts of a key held up every later reload for a quarter of an hour."""
    with pytest.raises(SettingsError, match="has a line of more than 20000 characters"):
        settings_of(tmp_path, MINIMAL + "a." * 300_000 + "b = 1")


def own_store(tmp_path: Path) -> str:
    return MINIMAL.replace("/var/lib/somewhere", str(tmp_path / "store"))


@pytest.mark.parametrize(
    ("api", "is_open"),
    [
        ("", False),
        ('host = "::1"', False),
        ('host = "0.0.0.0"', True),
        ('host = "::"', True),
        ('host = "plant"', True),
        (f'host = "0.0.0.0"\nkeys = [{{name = "mes", sha256 = "{64 * "0"}"}}]', False),
        ('host = "0.0.0.0"\nwithout_keys = "only this machine may ask"', True),
        ('host = "0.0.0.0"\nwithout_keys = "every host may read"', False),
    ],
)
def test_without_a_key_the_network_is_not_served_unless_told_in_words(
    tmp_path: Path, api: str, is_open: bool
):
    settings = settings_of(tmp_path, f"{own_store(tmp_path)}[api]\n{api}")
    found = [each for each in problems(settings) if "api" in each]
    assert [each.partition(":")[0] for each in found] == ["api.host"] * is_open
    assert all("stonefall keys create" in each and "every host may read" in each for each in found)
    create_key(settings.store.dir, "mes", (Scope.READ,), None, "root")
    assert not any("api" in each for each in [*problems(settings), *shortcomings(settings)])
    revoke_key(settings.store.dir, "mes", "root")  # it needs a key all the same
    assert not any("api" in each for each in problems(settings))


def test_a_damaged_file_of_keys_is_a_shortcoming_and_opens_nothing(tmp_path: Path):
    settings = settings_of(tmp_path, f'{own_store(tmp_path)}[api]\nhost = "0.0.0.0"')
    settings.store.dir.mkdir()
    (settings.store.dir / FILE).write_text("{")
    assert not any("api" in each for each in problems(settings))
    (found,) = (each for each in shortcomings(settings) if "api" in each)
    assert found.startswith(f"api.keys: {settings.store.dir / FILE}: Invalid JSON")


@pytest.mark.parametrize("nested", [5000 * "[" + 5000 * "]", 5000 * '{"a":' + "1" + 5000 * "}", 5000 * "9"])
def test_json_beyond_all_bounds_is_refused_with_the_file(tmp_path: Path, nested: str):
    path = tmp_path / "nested.json"
    path.write_text(nested)
    for read, error in ((read_rig, RecordingError), (read_volume_model, VolumeModelError)):
        with pytest.raises(error, match=r"nested\.json"):
            read(path)


def write_tiny_recording(path: Path) -> None:
    rig = nominal_rig()
    width_px, height_px = rig.cameras[0].image_size_px
    camera = rig.camera_ids[0]
    frame = Frame(
        camera=camera,
        image=np.zeros((height_px, width_px), np.uint8),
        frame_id=1,
        device_ns=0,
        received_ns=1,
    )
    bundle = FrameBundle(
        trigger=Trigger(sequence=1, received_ns=0, device_ns=0, utc="2026-11-21T04:00:00Z"),
        frames={camera: frame},
        missing=dict.fromkeys(rig.camera_ids[1:], "no_frame"),
    )
    source = RecordingSource(camera_ids=rig.camera_ids, rig=rig, is_simulated=True)
    with RecordingWriter(path, source, made_by={}) as writer:
        writer.add(bundle)


def test_files_and_folders_the_settings_speak_of_are_checked(tmp_path: Path):
    minimal = MINIMAL.replace("/var/lib/somewhere", "store")
    assert list(problems(settings_of(tmp_path, minimal))) == [
        f"rig.recording: {tmp_path}/recording: is not a recording: it has no recording.json"
    ]
    write_tiny_recording(tmp_path / "recording")
    assert list(problems(settings_of(tmp_path, minimal))) == []
    (tmp_path / "store").write_text("not a folder")
    assert list(problems(settings_of(tmp_path, minimal))) == [
        f"store.dir: cannot write to {tmp_path}/store: Not a directory"
    ]
    (tmp_path / "store").unlink()
    other = minimal.replace("[rig]", '[rig]\ncalibration = "other.json"')
    (wrong,) = problems(settings_of(tmp_path, other))
    assert wrong.startswith("rig.calibration: ")
    assert "other.json" in wrong
    rig = nominal_rig()
    write_rig(tmp_path / "other.json", replace(rig, cameras=rig.cameras[:15]))
    (wrong,) = problems(settings_of(tmp_path, other))
    assert wrong.startswith("rig.calibration: ")
    assert rig.camera_ids[15] in wrong
    write_rig(tmp_path / "other.json", small_rig(rig.camera_ids))
    (wrong,) = problems(settings_of(tmp_path, other))
    assert wrong.startswith(f"rig.calibration: {tmp_path}/other.json: camera c01: ")
    assert "64" in wrong


def test_enough_views_must_be_left_to_carve_with(tmp_path: Path):
    write_tiny_recording(tmp_path / "recording")
    text = MINIMAL.replace("/var/lib/somewhere", "store") + "[views]\nmin = 3\n[carving]\n"
    assert list(problems(settings_of(tmp_path, text + "max_disagreeing_views = 1"))) == []
    assert list(problems(settings_of(tmp_path, text + "max_disagreeing_views = 2"))) == [
        "views.min: must be at least 4, two more than carving.max_disagreeing_views, not 3"
    ]


def test_a_volume_model_that_cannot_be_used_is_named(tmp_path: Path):
    write_tiny_recording(tmp_path / "recording")
    text = MINIMAL.replace("/var/lib/somewhere", "store") + '[measuring]\nvolume_model = "basalt.json"'
    (missing,) = problems(settings_of(tmp_path, text))
    assert missing == f"measuring.volume_model: {tmp_path}/basalt.json: No such file or directory"
    write_volume_model(tmp_path / "basalt.json", VolumeModel(id="basalt", gap_share=1.0), {})
    settings = settings_of(tmp_path, text)
    assert list(problems(settings)) == []
    assert settings.pipeline.measuring.volume_model.id == "basalt"
    (useless,) = problems(settings_of(tmp_path, text + '\n[body]\nkind = "hull"'))
    assert (
        useless
        == 'measuring.volume_model: needs an estimated body: leave body.kind = "hull" out, or the model'
    )


@pytest.mark.parametrize(
    ("section", "is_textured"),
    [
        ("", True),
        ("texture = false", False),
        ('kind = "estimate"', False),
        ('kind = "estimate"\ntexture = true', True),
    ],
)
def test_meshes_are_textured_with_photo_unless_the_file_says_otherwise(
    tmp_path: Path, section: str, is_textured: bool
):
    assert settings_of(tmp_path, f"{MINIMAL}[body]\n{section}").pipeline.body.is_textured == is_textured
    with pytest.raises(SettingsError, match=r"body\.texture: .* boolean"):
        settings_of(tmp_path, f'{MINIMAL}[body]\ntexture = "much"')


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path):
    write_tiny_recording(tmp_path / "recording")
    settings = settings_of(tmp_path, MINIMAL.replace("/var/lib/somewhere", "/proc/stonefall"))
    (wrong,) = problems(settings)
    assert wrong.startswith("store.dir: cannot write to /proc: ")


def live_problems(folder: Path, *changes: tuple[str, str], text: str = LIVE) -> list[str]:
    write_rig(folder / "rig.json", nominal_rig())
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return list(problems(settings_of(folder, text)))


def test_a_live_rig_is_described_to_its_devices(tmp_path: Path):
    assert live_problems(tmp_path) == []
    settings = settings_of(
        tmp_path, LIVE.replace("[rig]", '[rig]\nstrobe_line = "Line2"\nfeatures = [["A", 1]]')
    )
    assert isinstance(settings.rig, AravisRigSettings)
    backend = settings.rig.backend_for(nominal_rig())
    camera = backend.cameras[2]
    assert (camera.id, camera.serial, camera.image_size_px) == ("c03", "SIM0003", (1280, 1024))
    features = dict(camera.features)
    assert features["TriggerDelay"] == pytest.approx(247_350, abs=10)  # 0.3 m of free fall
    assert (features["TriggerSource"], features["ExposureTime"], features["A"]) == ("Line1", 20.0, 1)
    names = [name for name, _ in camera.features]
    assert names.index("LineSelector") < names.index("LineSource")
    assert backend.gate == SerialGateSettings(port=f"{tmp_path}/gate")
    assert backend.fired_by is None


@pytest.mark.parametrize(
    ("more", "is_warned"),
    [
        ("", True),
        ('strobe_line = "Line2"', False),
        ("flash_us = 15", False),  # fired by something else
        ('features = [["LineSelector", "Line3"], ["LineSource", "ExposureActive"]]', False),
        ("is_simulated = true", False),
    ],
)
def test_a_live_rig_whose_light_does_not_flash_is_a_warning_and_no_fault(
    more: str, is_warned: bool, tmp_path: Path
):
    write_rig(tmp_path / "rig.json", nominal_rig())
    settings = settings_of(tmp_path, LIVE.replace("[rig]", f"[rig]\n{more}"))
    assert not any("strobe" in each for each in [*problems(settings), *shortcomings(settings)])
    assert [each.partition(":")[0] for each in rig_warnings(settings.rig, settings.bundling)] == [
        "rig.strobe_line"
    ] * is_warned


def test_examples_and_recordings_are_not_warned_of(tmp_path: Path):
    for name in ("demo.toml", "simulated.toml"):
        settings = load_settings(DEPLOY / name)
        assert list(rig_warnings(settings.rig, settings.bundling)) == []


def test_a_recording_of_a_live_rig_says_how_fast_stones_pass_the_gate(tmp_path: Path):
    settings = settings_of(tmp_path, LIVE.replace("[rig]", "[rig]\nstart_above_gate_mm = 5"))
    assert isinstance(settings.rig, AravisRigSettings)
    devices = build_devices(settings.rig.backend_for(nominal_rig()))
    source = settings.rig.source(devices, nominal_rig())
    assert source.fall == settings.rig.fall
    assert source.gate_settings["speed_at_gate_mm_s"] == pytest.approx(313.2, abs=0.1)
    assert source.gate_settings["fall_height_mm"] == source.fall.height_mm
    assert source.camera_settings == {
        name: value for name, value in settings.model_dump(mode="json")["rig"].items() if name != "gate"
    }
    assert source.gate_settings["serial"]["port"] == f"{tmp_path}/gate"


def test_the_kept_background_depends_on_what_the_cameras_see_alone(tmp_path: Path):
    def optical(line: str) -> list[Any] | None:
        return settings_of(tmp_path, LIVE.replace("[rig]", f"[rig]\n{line}")).rig.optical_settings

    assert optical("uplink_bytes_s = 1e9") == optical("")
    assert optical("exposure_us = 10") != optical("")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            ("[rig]", "[rig]\nexposure_us = 100"),
            "rig.exposure_us: 101 us of light and skew blur a stone of 2.43 m/s by",
        ),
        (("[rig]", "[rig]\nexposure_us = 100\nflash_us = 10"), None),
        (("[rig]", "[rig]\ntrigger_skew_us = 60"), "rig.exposure_us: 80 us of light and skew"),
        (
            ("[rig]", "[rig]\nfall_height_mm = 600"),
            "bundling.expected_delay_ms: frames come 349.8 ms after their trigger (fall of 600 mm)",
        ),
        (
            ("[rig]", "[rig]\nuplink_bytes_s = 125e6"),
            "rig.packet_delay_ns: 16 cameras send 2000 MB/s at once, the uplink takes 125, and 20",
        ),
        (
            ("[rig]", "[rig]\nuplink_bytes_s = 125e6\nthroughput_limit_bytes_s = 7_800_000"),
            "a frame takes 170 ms",
        ),
        (("[rig]", "[rig]\nuplink_bytes_s = 125e6\npacket_delay_ns = 1_000_000"), "a frame takes 174 ms"),
        (('id = "c07"', 'id = "c17"'), "rig.cameras: c01, c02"),
        (('"rig.json"', '"none.json"'), "rig.calibration: "),
    ],
)
def test_what_physics_does_not_allow_is_named(tmp_path: Path, change: tuple[str, str], problem: str | None):
    found = live_problems(tmp_path, change)
    assert any(problem in each for each in found) if problem else found == []


def test_a_gate_without_a_clock_needs_a_dead_time_like_the_cameras(tmp_path: Path):
    modem = ("[rig.gate.serial]", "[rig.gate.modem_line]")
    short = ("[spool]", "[bundling]\ndead_time_ms = 205\n[spool]")
    assert live_problems(tmp_path, short) == []
    (problem,) = live_problems(tmp_path, modem, short)
    assert problem.startswith("bundling.dead_time_ms: cameras ignore an edge for 247.4 ms after another")


def test_a_shared_gigabit_uplink_needs_throttled_cameras_and_a_wide_window(tmp_path: Path):
    rig = "[rig]\nuplink_bytes_s = 125e6\nthroughput_limit_bytes_s = 7_800_000"
    slow = "[bundling]\nwindow_ms = 170\ndead_time_ms = 400\n[spool]"
    assert live_problems(tmp_path, ("[rig]", rig), ("[spool]", slow)) == []


def test_packets_of_negotiated_size_are_checked_at_their_largest_and_their_smallest(tmp_path: Path):
    rig = '[rig]\nuplink_bytes_s = 1.25e9\npacket_size_bytes = "negotiate"\npacket_delay_ns = '
    assert live_problems(tmp_path, ("[rig]", rig + "57_000")) == []
    (problem,) = live_problems(tmp_path, ("[rig]", rig + "40_000"))
    assert "set it to 56300 or more" in problem


def test_a_network_that_stones_outrun_is_a_warning(tmp_path: Path):
    write_rig(tmp_path / "rig.json", nominal_rig())
    quick = "delay_outside_ms = 247\nflash_us = 20\nuplink_bytes_s = 125e6\npacket_delay_ns = 1_104_700"
    text = LIVE.replace("[rig]", f"[rig]\n{quick}") + "[bundling]\ndead_time_ms = 180\nwindow_ms = 80\n"
    settings = settings_of(tmp_path, text)
    (warning,) = rig_warnings(settings.rig, settings.bundling)
    assert warning.startswith(
        "rig.uplink_bytes_s: a bundle takes 191 ms on the wire, but stones may come every 180 ms"
    )
    for old, new in (
        ("dead_time_ms = 180", "dead_time_ms = 200"),
        ("= 125e6\npacket_delay_ns", "= 1.25e9\n# "),
    ):
        settings = settings_of(
            tmp_path, text.replace(old, new)
        )  # of a switch that overflows it is no warning
        assert list(rig_warnings(settings.rig, settings.bundling)) == []


def test_another_camera_than_the_calibrated_one_is_found_before_it_measures(tmp_path: Path):
    rig = nominal_rig()
    calibrated = replace(
        rig, cameras=tuple(replace(camera, serial=f"SIM{i:04d}") for i, camera in enumerate(rig.cameras))
    )
    write_rig(tmp_path / "rig.json", calibrated)
    found = list(problems(settings_of(tmp_path, LIVE)))
    assert len(found) == 16
    assert found[0].startswith("rig.cameras: c01 has serial number SIM0001, but ")
    assert "was made with SIM0000" in found[0]


def spelled_out(file: Path) -> dict[str, Any]:
    """Return what the file would say if none of its lines were a comment."""
    return tomllib.loads(re.sub(r"^# (?=\[|[a-z_0-9]+ = )", "", file.read_text(), flags=re.MULTILINE))


@pytest.mark.parametrize("name", ["stonefall.toml", "demo.toml", "simulated.toml"])
def test_the_examples_are_valid_and_their_comments_are_the_defaults(name: str):
    settings = load_settings(DEPLOY / name)

    def without_examples(said: Any, default: Any) -> Any:
        """Leave out values, also of tables in a list, of settings that have none."""
        if isinstance(said, list) and isinstance(default, list) and len(said) == len(default):
            return [without_examples(*pair) for pair in zip(said, default, strict=True)]
        if not (isinstance(said, dict) and isinstance(default, dict)):
            return said
        return {
            key: without_examples(value, default.get(key))
            for key, value in said.items()
            if key not in default or default[key] not in (None, [])
        }

    said = without_examples(spelled_out(DEPLOY / name), settings.model_dump(mode="json"))
    assert Settings.model_validate(said, context={"folder": DEPLOY}) == settings


SETTINGS_WITHIN = {
    "rig.cameras": CameraPlace,
    "rig.gate.modem_line": ModemLineSettings,
    "rig.gate.gpio": GpioGateSettings,
    "api.keys": ApiKey,
    "webhooks.endpoints": WebhookEndpoint,
    "file_drop": FileDropSettings,
}
"""What is in lists, and in sections that are not set: `check-config` prints it once it is there."""


def test_the_example_has_every_setting_that_check_config_prints():
    file = DEPLOY / "stonefall.toml"
    settings, said = load_settings(file).model_dump(mode="json"), spelled_out(file)
    missing: list[str] = []

    def compare(printed: dict[str, Any], told: dict[str, Any], name: str) -> None:
        for key, value in printed.items():
            if key not in told:
                missing.append(name + key)
            elif isinstance(value, dict):
                compare(value, told[key], f"{name}{key}.")

    compare(settings, said, "")
    for name, kind in SETTINGS_WITHIN.items():
        told: Any = said
        for key in name.split("."):
            told = told.get(key, {})
        first = told[0] if isinstance(told, list) else told
        missing += [f"{name}.{each.name}" for each in fields(kind) if each.name not in first]
        if not isinstance(told, list):
            defaults = {each.name: each.default for each in fields(kind)}
            wrong = {
                key: value
                for key, value in first.items()
                if defaults[key] not in (MISSING, None) and value != json.loads(json.dumps(defaults[key]))
            }
            assert wrong == {}, name
    assert missing == []


@pytest.mark.parametrize("source", ["Line0", "Input1", "Hardware", "Timer1Active", "Counter1End", "TTLIn1"])
def test_any_source_of_a_camera_can_trigger(source: str, tmp_path: Path) -> None:
    """pypylon 526, harvesters 233: the delay is a timer's or a counter's, and inputs are not all called Line."""
    (tmp_path / "stonefall.toml").write_text(LIVE.replace("[rig]", f'[rig]\ntrigger = "{source}"'))
    rig = load_settings(tmp_path / "stonefall.toml").rig
    assert isinstance(rig, AravisRigSettings)
    features = [feature for camera in rig.sought_cameras() for feature in camera.features]
    assert features.count(("TriggerSource", source)) == len(rig.cameras)
    assert features.count(("TriggerActivation", "RisingEdge")) == len(rig.cameras)


def test_a_camera_whose_input_has_another_name_has_a_trigger_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "stonefall.toml").write_text(LIVE.replace('id = "c02"', 'id = "c02"\ntrigger = "Line0"'))
    rig = load_settings(tmp_path / "stonefall.toml").rig
    assert isinstance(rig, AravisRigSettings)
    sources = [dict(camera.features)["TriggerSource"] for camera in rig.sought_cameras()]
    assert sources[:3] == ["Line1", "Line0", "Line1"]


def test_a_delay_outside_of_the_cameras_is_not_theirs(tmp_path: Path) -> None:
    """The gate makes 247.2 of 247.4 ms: frames come as late, and the cameras are ready for the next edge."""
    (tmp_path / "stonefall.toml").write_text(LIVE.replace("[rig]", "[rig]\ndelay_outside_ms = 247.2"))
    settings = load_settings(tmp_path / "stonefall.toml")
    rig = settings.rig
    assert isinstance(rig, AravisRigSettings)
    assert list(timing_problems(rig, rig.bundling_for(settings.bundling))) == []
    assert {dict(camera.features)["TriggerDelay"] for camera in rig.sought_cameras()} == {152.0}
    assert rig.exposed_ms == pytest.approx(247.372, abs=0.001)
    assert rig.busy_ms == pytest.approx(0.172, abs=0.001)
    assert rig.bundling_for(settings.bundling) == BundlingParameters()  # as before there was `delay`
    whole = replace(rig, delay_outside_ms=rig.trigger_delay_ms)
    assert {dict(camera.features)["TriggerDelay"] for camera in whole.sought_cameras()} == {0.0}


QUICK = ("[rig]", '[rig]\ndelay = "gate"')


def test_a_delay_of_the_gate_lets_stones_be_in_the_air_together(tmp_path: Path) -> None:
    assert live_problems(tmp_path, QUICK) == []
    settings = load_settings(tmp_path / "stonefall.toml")
    rig = settings.rig
    assert isinstance(rig, AravisRigSettings)
    assert {dict(camera.features)["TriggerDelay"] for camera in rig.sought_cameras()} == {0.0}
    assert rig.backend_for(nominal_rig()).gate_delay_us == rig.gate_delay_us == 247_352
    bundling = rig.bundling_for(settings.bundling)
    assert (bundling.window_ms, bundling.dead_time_ms) == (10, 25)
    assert bundling.expected_delay_ms == pytest.approx(257.372, abs=0.001)


def test_a_timer_makes_all_of_the_delay_or_what_is_said(tmp_path: Path) -> None:
    for more, delay_us in (("", 0.0), ("\ndelay_outside_ms = 200", 47_352.0)):
        assert live_problems(tmp_path, ("[rig]", f'[rig]\ndelay = "timer"{more}')) == []
        rig = load_settings(tmp_path / "stonefall.toml").rig
        assert isinstance(rig, AravisRigSettings)
        assert {dict(camera.features)["TriggerDelay"] for camera in rig.sought_cameras()} == {delay_us}
        assert rig.gate_delay_us == 0


@pytest.mark.parametrize(
    "section", ["window_ms = 5", "dead_time_ms = 15", "dead_time_ms = 300", "window_ms = 90"]
)
def test_what_is_said_of_the_bundling_holds_with_stones_in_the_air(tmp_path: Path, section: str) -> None:
    assert live_problems(tmp_path, QUICK, ("[spool]", f"[bundling]\n{section}\n[spool]")) == []
    settings = load_settings(tmp_path / "stonefall.toml")
    bundling = settings.rig.bundling_for(settings.bundling)
    name, value = section.split(" = ")
    assert getattr(bundling, name) == float(value)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            [("[rig]", '[rig]\ndelay = "camera"\ndelay_outside_ms = 5')],
            'rig: delay = "camera" leaves nothing outside',
        ),
        (
            [QUICK, ("[rig.gate.serial]", "[rig.gate.modem_line]")],
            'rig: delay = "gate" needs [rig.gate.serial]',
        ),
        (
            [("[rig]", '[rig]\ndelay = "gate"\ntrigger = "action"')],
            "rig: delay: this machine triggers the cameras",
        ),
        ([("[rig]", '[rig]\ndelay = "host"')], "rig.delay"),
    ],
)
def test_a_delay_that_nothing_can_make_is_refused(
    tmp_path: Path, changes: list[tuple[str, str]], problem: str
) -> None:
    with pytest.raises(SettingsError, match=re.escape(problem)):
        live_problems(tmp_path, *changes)


def test_check_config_prints_settings_that_it_reads_again(tmp_path: Path):
    folder = tmp_path / "Körnung \U0001f6a7 \x7f"  # what TOML writes other than JSON
    folder.mkdir()
    path = folder / "stonefall.toml"
    path.write_text(MINIMAL.replace("/var/lib/somewhere", "store"), encoding="utf-8")
    write_tiny_recording(folder / "recording")
    good = CliRunner().invoke(build_app(), ["check-config", str(path)])
    assert good.exit_code == 0, good.output
    assert "[measuring]\n# density_kg_m3 is not set\n" in good.stdout
    assert "keep_raw = 200" in good.stdout
    again = tmp_path / "again.toml"
    again.write_text(good.stdout, encoding="utf-8")
    assert load_settings(again) == load_settings(path)
    repeated = CliRunner().invoke(build_app(["check-config"]), ["check-config", str(again)])
    assert (repeated.exit_code, repeated.stdout) == (0, good.stdout)

    path.write_text(MINIMAL)
    (folder / "recording/rig.json").unlink()
    bad = CliRunner().invoke(build_app(), ["check-config", str(path), "--json"])
    assert bad.exit_code == 1
    document = json.loads(bad.stdout)
    assert document["url"] == "http://127.0.0.1:8080"  # where deploy/install asks the daemon
    assert document["settings"]["workers"]["slots"] == 2
    assert "rig.calibration: " in document["problems"][0]
    assert document["warnings"] == []


@pytest.mark.parametrize("name", ["stonefall.toml", "simulated.toml"])
def test_check_config_prints_live_rigs_that_it_reads_again(name: str, tmp_path: Path):
    printed = CliRunner().invoke(build_app(["check-config"]), ["check-config", str(DEPLOY / name)]).stdout
    again = tmp_path / "again.toml"
    again.write_text(printed, encoding="utf-8")
    assert load_settings(again) == load_settings(DEPLOY / name)


@pytest.mark.parametrize("is_of_the_unit", [True, False])
def test_a_credential_is_read_where_the_service_manager_puts_it(
    is_of_the_unit: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "credentials" if is_of_the_unit else Path("/run/credentials/stonefall.service")
    if is_of_the_unit:
        monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(folder))
        folder.mkdir()
        (folder / "mes.secret").write_text(f"whsec_{32 * 'A'}\n")
    else:
        monkeypatch.delenv("CREDENTIALS_DIRECTORY", raising=False)
    endpoint = (
        '[webhooks]\nallowed_hosts = ["127.0.0.1"]\n[[webhooks.endpoints]]\nname = "mes"\nurl = "http://127.0.0.1/"\n'
        'secret_files = ["$CREDENTIALS_DIRECTORY/mes.secret"]\n'
    )
    settings = settings_of(tmp_path, LIVE + endpoint)
    (webhook,) = settings.webhooks.endpoints
    assert webhook.secret_files == (folder / "mes.secret",)
    told = [each for each in shortcomings(settings) if "mes" in each]
    assert told == [] if is_of_the_unit else f"{folder / 'mes.secret'}: No such file" in told[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "No such file"), (b"x" * 500_001, "has more than"), (b"x", "is no PNG or SVG")],
)
def test_a_logo_that_is_none_is_named_at_the_start(
    tmp_path: Path, content: bytes | None, reason: str
) -> None:
    file = tmp_path / "stonefall.toml"
    file.write_text(MINIMAL + '[plant]\nlogo = "logo.svg"')
    if content is not None:
        (tmp_path / "logo.svg").write_bytes(content)
    found = [each for each in problems(load_settings(file)) if each.startswith("plant")]
    assert len(found) == 1
    assert found[0].startswith(f"plant.logo: {tmp_path / 'logo.svg'}: ")
    assert reason in found[0]
