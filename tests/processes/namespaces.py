"""Hosts that are network namespaces: each with an address of its own, joined by a switch, cut off and healed.

The switch is a bridge in a namespace of its own, so nothing of this is seen from outside: no interface,
address or route is added to the machine's own network, and no packet can leave. Addresses are of
192.0.2.0/24, which RFC 5737 keeps for examples. Names hold the test process's id, so that what a crashed
one left behind is told from what a living one uses.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Self

import pytest

from tests.processes.owned import Owner, Process

COMMAND_SECS = 10.0
MOST_HOSTS = 200
ENTER = "import os, sys; os.execvp('ip', ['ip', 'netns', 'exec', *sys.argv[1:]])"
"""Becomes the command inside the namespace; the process id stays, so its owner can end it."""
NAME = re.compile(r"babble-(?P<pid>\d+)-[a-z0-9]+")


class Host:
    """One namespace with one interface, `eth0`, and one address."""

    def __init__(self, network: "Network", name: str, address: str) -> None:
        self.name = name
        self.address = address
        self._network = network
        self._namespace = network.namespace(name)
        _new_namespace(self._namespace)
        peer = ("peer", "name", "eth0", "netns", self._namespace)
        network.switch("link", "add", f"port-{name}", "type", "veth", *peer)
        network.switch("link", "set", f"port-{name}", "master", "bridge", "up")
        _ip("-n", self._namespace, "address", "add", f"{address}/24", "dev", "eth0")
        _ip("-n", self._namespace, "link", "set", "eth0", "up")

    def start(self, owner: Owner, label: str, *command: str, **environment: str) -> Process:
        """Start a command on this host, such as `sys.executable, "-m", "services.router"`."""
        arguments = ("-c", ENTER, self._namespace, *command)
        return owner.start(label, *arguments, environment=environment)

    def start_service(self, owner: Owner, service: str, *arguments: str, **environment: str) -> Process:
        """Start `python -m services.<service> <arguments>` on this host."""
        module = (sys.executable, "-m", f"services.{service}")
        return self.start(owner, f"{service} on {self.name}", *module, *arguments, **environment)

    def cut_off(self) -> None:
        """A partition: from now on no packet arrives here or comes from here, and nobody is told."""
        self._partition("-A")

    def heal(self) -> None:
        """End the partition."""
        self._partition("-D")

    def unplug(self) -> None:
        """The interface loses its carrier, as when the cable is pulled."""
        self._network.switch("link", "set", f"port-{self.name}", "down")

    def plug(self) -> None:
        """The cable is back."""
        self._network.switch("link", "set", f"port-{self.name}", "up")

    def _partition(self, action: str) -> None:
        # Dropped where it arrives: a sender whose own host drops its packets would be told so.
        self.drop(action, "-i", "eth0")
        for other in self._network.others(self):
            other.drop(action, "-s", self.address)

    def drop(self, action: str, *what: str) -> None:
        """Add ("-A") or delete ("-D") the rule that drops what arrives here and matches."""
        inside = ("ip", "netns", "exec", self._namespace)
        _run(*inside, "iptables", "-w", action, "INPUT", *what, "-j", "DROP")


class Network:
    """A switch and the hosts at it; all of it goes when the `with` block ends."""

    def __init__(self) -> None:
        self._hosts: dict[str, Host] = {}
        self._switch = self.namespace("switch")

    def namespace(self, name: str) -> str:
        """The name of this test process's namespace for a host."""
        return f"babble-{os.getpid()}-{name}"

    def host(self, name: str) -> Host:
        """A new host; its name is one to eight letters and digits."""
        assert re.fullmatch("[a-z0-9]{1,8}", name), "an interface's name holds no more"
        assert len(self._hosts) < MOST_HOSTS
        self._hosts[name] = Host(self, name, f"192.0.2.{len(self._hosts) + 1}")
        return self._hosts[name]

    def others(self, host: Host) -> list[Host]:
        """All hosts but this one."""
        return [other for other in self._hosts.values() if other is not host]

    def switch(self, *command: str) -> None:
        """Run `ip` in the namespace of the switch."""
        _ip("-n", self._switch, *command)

    def __enter__(self) -> Self:
        """Raises `CannotLay` if the machine lacks something that hosts need."""
        try:
            _new_namespace(self._switch)
            self.switch("link", "add", "bridge", "type", "bridge")
            self.switch("link", "set", "bridge", "up")
            self.switch("link", "add", "probe", "type", "veth")
            self.switch("link", "delete", "probe")
            _run("ip", "netns", "exec", self._switch, "iptables", "-w", "-L")
        except AssertionError as refused:
            raise CannotLay(str(refused)) from None
        return self

    def __exit__(self, *_: object) -> None:
        sweep()


@contextmanager
def laid_network() -> Iterator[Network]:
    """A network for one test; skips the test, with the reason, where the machine allows none."""
    sweep()
    try:
        with Network() as network:
            yield network
    except CannotLay as reason:
        pytest.skip(f"no network namespaces here: {reason}")
    finally:
        sweep()


class CannotLay(Exception):
    """This machine or this user may not make namespaces."""


def sweep() -> None:
    """Remove the namespaces of this process and of test processes that are gone, and all that runs there."""
    if os.geteuid() != 0 or shutil.which("ip") is None:
        return
    for name in _names():
        found = NAME.fullmatch(name)
        if found and (int(found["pid"]) == os.getpid() or not os.path.exists(f"/proc/{found['pid']}")):
            _remove(name)


def _remove(name: str) -> None:
    inside = subprocess.run(
        ["ip", "netns", "pids", name], capture_output=True, text=True, timeout=COMMAND_SECS
    )
    pids = [int(pid) for pid in inside.stdout.split()]
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    _ip("netns", "delete", name)


def _names() -> list[str]:
    listed = subprocess.run(["ip", "netns", "list"], capture_output=True, text=True, timeout=COMMAND_SECS)
    return [line.split()[0] for line in listed.stdout.splitlines() if line.strip()]


def _new_namespace(name: str) -> None:
    if os.geteuid() != 0:
        raise CannotLay("only root may make them")
    for tool in ("ip", "iptables"):
        if shutil.which(tool) is None:
            raise CannotLay(f"there is no command {tool} (Debian's packages iproute2 and iptables)")
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, timeout=COMMAND_SECS)
    if made.returncode != 0:
        raise CannotLay(made.stderr.strip())
    _ip("-n", name, "link", "set", "lo", "up")


def _ip(*command: str) -> None:
    _run("ip", *command)


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=COMMAND_SECS)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr.strip()}"
