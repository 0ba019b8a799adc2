"""The ports of the dashboard: the usual ones, those asked for, and what happens when they are taken."""

import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.launcher import dashboard
from services.launcher.dashboard import Choice, PortError, Ports, ports_for, words


@pytest.fixture(autouse=True)
def usual_ports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Usual ports of this test's own, and locks in a folder of its own."""
    web, grpc = free_port(), free_port()
    monkeypatch.setattr(dashboard, "WEB_PORT", web)
    monkeypatch.setattr(dashboard, "GRPC_PORT", grpc)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return web, grpc


@pytest.fixture
def taken() -> Iterator[int]:
    """A port on which somebody listens."""
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        yield int(holder.getsockname()[1])


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_usual_ports_are_taken_if_they_are_free(usual_ports: tuple[int, int]) -> None:
    with Ports(Choice()) as ports:
        assert (ports.web, ports.grpc) == usual_ports
        assert words(Choice(), ports) == f"http://127.0.0.1:{usual_ports[0]}"


def test_usual_ports_that_are_taken_give_way_and_it_is_said(
    taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dashboard, "WEB_PORT", taken)
    with Ports(Choice()) as ports:
        assert ports.web not in (taken, ports.grpc)
        assert words(Choice(), ports) == f"http://127.0.0.1:{ports.web} (port {taken} is taken)"


def test_a_port_that_was_asked_for_and_is_taken_is_one_sentence(taken: int) -> None:
    with pytest.raises(PortError, match=rf"--dashboard-port {taken}: .*in use.*; choose another port"):
        Ports(Choice(web_port=taken))
    with pytest.raises(PortError, match=rf"--dashboard-grpc-port {taken}: "):
        Ports(Choice(grpc_port=taken))


def test_what_is_asked_for_wins_over_what_is_usual(usual_ports: tuple[int, int]) -> None:
    with Ports(Choice(grpc_port=usual_ports[0])) as ports:
        assert ports.grpc == usual_ports[0]
        assert ports.web != usual_ports[0]


def test_two_runs_that_start_together_never_share_a_port(usual_ports: tuple[int, int]) -> None:
    with Ports(Choice()) as first, Ports(Choice()) as second:
        assert len({first.web, first.grpc, second.web, second.grpc}) == 4
        with pytest.raises(PortError):
            Ports(Choice(web_port=first.web))
    with Ports(Choice()) as third:
        assert (third.web, third.grpc) == usual_ports, "what a run leaves is free again"


def test_without_a_place_for_locks_there_are_ports_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, usual_ports: tuple[int, int]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with Ports(Choice()) as ports:
        assert (ports.web, ports.grpc) == usual_ports


def test_a_run_without_the_package_or_the_wish_has_no_dashboard(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ports_for(Choice(wanted=False)) is None
    assert words(Choice(wanted=False), None) == "none (--no-dashboard)"
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert ports_for(Choice()) is None
    assert "babble doctor" in words(Choice(), None)


def test_a_free_port_that_another_starting_run_holds_gives_way_to_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[int] = []
    lock = Ports._lock

    def held_at_first(self: Ports, port: int) -> None:
        tried.append(port)
        if len(tried) < 3:
            raise OSError(98, "Address already in use")
        lock(self, port)

    monkeypatch.setattr(Ports, "_lock", held_at_first)
    with Ports(Choice(web_port=0, grpc_port=0)) as ports:
        assert ports.web == tried[2]
        assert ports.grpc == tried[3]
