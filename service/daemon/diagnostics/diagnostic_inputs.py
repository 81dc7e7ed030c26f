"""What of a configuration goes into an archive for support, and what must not."""

from service.configuration.host_needs import host_needs
from service.configuration.settings import Settings
from service.daemon.diagnostics.inputs import Inputs, Secrets


def diagnostic_inputs(settings: Settings) -> Inputs:
    """Return where an archive is made from; reads the rig file."""
    endpoints = settings.webhooks.endpoints
    values = {secret.get_secret_value() for endpoint in endpoints for secret in endpoint.secrets}
    values |= {key.sha256 for key in settings.api.keys}
    return Inputs(
        store_dir=settings.store.dir,
        calibration=settings.rig.calibration_path,
        needs=host_needs(settings),
        secrets=Secrets(
            values=frozenset(values),
            files=tuple(path for endpoint in endpoints for path in endpoint.secret_files),
        ),
        configuration=settings.model_dump(mode="json"),
    )
