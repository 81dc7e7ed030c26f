"""What of a configuration goes into an archive for support, and what must not."""

from contextlib import suppress

from service.configuration.host_needs import host_needs
from service.configuration.settings import Settings
from service.daemon.diagnostics.archive import Inputs


def diagnostic_inputs(settings: Settings) -> Inputs:
    """Return where an archive is made from; reads the rig file, and those of secrets."""
    secrets = {key.sha256 for key in settings.api.keys}
    for endpoint in settings.webhooks.endpoints:
        secrets |= {secret.get_secret_value() for secret in endpoint.secrets}
        for path in endpoint.secret_files:
            with suppress(OSError):
                secrets.add(path.read_text(encoding="utf-8", errors="replace").strip())
    return Inputs(
        store_dir=settings.store.dir,
        calibration=settings.rig.calibration_path,
        needs=host_needs(settings),
        secrets=frozenset(secrets),
        configuration=settings.model_dump(mode="json"),
    )
