from drivers.errors import LossCause
from service.acquisition.device_keeper import DeviceLoss
from service.acquisition.rig_cameras import common_cause


def test_cameras_that_are_all_silent_are_the_switch():
    losses = [
        DeviceLoss("does not answer", LossCause.SILENT),
        DeviceLoss("no camera at 127.0.0.1", LossCause.SILENT),
    ]
    told = common_cause(losses)
    assert told.startswith("all 2 cameras are gone: look at the switch")
    assert told.endswith("; the first one: does not answer")


def test_cameras_that_answer_and_belong_to_someone_else_are_not_the_switch():
    taken = DeviceLoss("is in use by another application", LossCause.IN_USE)
    silent = DeviceLoss("does not answer", LossCause.SILENT)
    assert (
        common_cause([taken, silent])
        == "all 2 cameras are lost, the first one: is in use by another application"
    )


def test_losses_of_one_kind_are_alike_whatever_their_words():
    silent = DeviceLoss("does not answer", LossCause.SILENT)
    assert silent.is_like(DeviceLoss("does not answer: cannot read register 0xa00", LossCause.SILENT))
    assert not silent.is_like(DeviceLoss("does not answer", LossCause.IN_USE))
    assert not silent.is_like(None)
    other = DeviceLoss("no memory", LossCause.OTHER)
    assert other.is_like(DeviceLoss("no memory", LossCause.OTHER))
    assert not other.is_like(DeviceLoss("no room", LossCause.OTHER))
