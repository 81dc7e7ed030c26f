"""All checks of the host, in the order in which they are reported."""

from service.host.finding import Finding
from service.host.host import Host
from service.host.machine import check_machine
from service.host.needs import HostNeeds
from service.host.network import check_network


def check_host(host: Host, needs: HostNeeds) -> list[Finding]:
    """Check a host; reads files, and asks each network port for its receive ring."""
    network = [] if needs.network is None else [*check_network(host, needs.network)]
    return [*network, *check_machine(host, needs)]
