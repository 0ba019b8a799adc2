"""The hosts that tests make: they reach one another unless they are cut off, and nothing is left behind."""

import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest

from tests.processes.namespaces import ENTER, Host, Network, laid_network, sweep
from tests.processes.owned import Owner, Process, wait_for

pytestmark = pytest.mark.processes

LISTEN = """
import socket, sys
with socket.create_server((sys.argv[1], 7000)) as listener:
    print("listening", flush=True)
    while True:
        listener.accept()[0].close()
"""
KNOCK = """
import socket, sys
try:
    socket.create_connection((sys.argv[1], 7000), timeout=float(sys.argv[2])).close()
    print("reached")
except OSError as error:
    print(type(error).__name__)
"""
NOBODY = 2**22 + 1
"""No process has this id: the kernel's largest is 2**22."""


@pytest.fixture
def network() -> Iterator[Network]:
    with laid_network() as network:
        yield network


@pytest.fixture
def hosts(network: Network) -> tuple[Host, Host]:
    return network.host("one"), network.host("two")


def reaches(owner: Owner, host: Host, other: Host, within_secs: float) -> bool:
    """True if a connection from one host to the other could be had."""
    command = (sys.executable, "-c", KNOCK, other.address, str(within_secs))
    knocking = host.start(owner, f"knock from {host.name}", *command)
    assert knocking.ended() == 0
    return knocking.out == ["reached"]


def listening(owner: Owner, host: Host) -> Process:
    listener = host.start(owner, f"listener on {host.name}", sys.executable, "-c", LISTEN, host.address)
    listener.expect("listening")
    return listener


@pytest.mark.parametrize(
    ("part", "join"), [(Host.cut_off, Host.heal), (Host.unplug, Host.plug)], ids=["cut off", "unplugged"]
)
def test_hosts_reach_each_other_unless_one_is_parted(
    owner: Owner, hosts: tuple[Host, Host], part: Callable[[Host], None], join: Callable[[Host], None]
) -> None:
    one, two = hosts
    for host in hosts:
        listening(owner, host)
    assert reaches(owner, one, two, 5.0)
    assert reaches(owner, two, one, 5.0)
    part(two)
    assert not reaches(owner, one, two, 0.5)
    assert not reaches(owner, two, one, 0.5)
    join(two)
    assert reaches(owner, one, two, 5.0)
    assert reaches(owner, two, one, 5.0)


def test_a_host_has_no_way_out(owner: Owner, hosts: tuple[Host, Host]) -> None:
    routes = hosts[0].start(owner, "routes", "ip", "route")
    assert routes.ended() == 0
    assert [line.split()[0] for line in routes.out] == ["192.0.2.0/24"]


def test_a_crashed_test_process_leaves_its_hosts_to_the_next_one(
    owner: Owner, hosts: tuple[Host, Host]
) -> None:
    left = f"babble-{NOBODY}-left"
    subprocess.run(["ip", "netns", "add", left], check=True, timeout=10)
    sleeping = "import time; print('here', flush=True); time.sleep(60)"
    orphan = owner.start_code("orphan", ENTER, left, sys.executable, "-c", sleeping)
    orphan.expect("here")
    sweep()
    wait_for("the orphan's end", lambda: not orphan.running())
    listed = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, check=True, timeout=10)
    assert left not in listed.stdout
