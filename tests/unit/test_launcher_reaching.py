"""Which run a command means: by folder, by name under runs/, by name at a router, or the one that goes on."""

from pathlib import Path

import pytest

from services.launcher.reaching import NotRunning, reach
from services.launcher.run_folder import RunFolder, RunFolderError
from services.runtime.settings import RunSettings

LAB = "tls/lab:7447"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for variable in ("BABBLE_CONNECT", "BABBLE_CREDENTIAL", "BABBLE_RUN"):
        monkeypatch.delenv(variable, raising=False)
    return tmp_path


@pytest.fixture
def folder(here: Path) -> RunFolder:
    made = RunFolder.create(RunSettings(scenario="s"), here / "runs" / "mine", [], run="mine")
    made.note_endpoint("tcp/127.0.0.1:1234")
    return made


def test_a_run_of_babble_up_is_reached_where_its_folder_says(folder: RunFolder) -> None:
    with folder.locked():
        for name in (None, "mine", "runs/mine", str(folder.path)):
            found = reach(name, None)
            assert (found.run, found.endpoint()) == ("mine", "tcp/127.0.0.1:1234")
            assert found.folder is not None
        folder.note_endpoint("tcp/127.0.0.1:4321")
        assert found.endpoint() == "tcp/127.0.0.1:4321", "a resumed run has another address"


def test_a_run_that_does_not_go_on_is_said_to(folder: RunFolder) -> None:
    with pytest.raises(NotRunning, match=r"not going on here; .*`babble up --resume runs/mine`.*--connect"):
        reach("mine", None).endpoint()
    with pytest.raises(NotRunning, match="no run is going on in runs/"):
        reach(None, None)
    with pytest.raises(RunFolderError, match="is not the folder of a run"):
        reach("other", None)


def test_with_an_address_a_bare_name_is_that_of_a_run_there(folder: RunFolder) -> None:
    found = reach("mine", LAB)
    assert (found.run, found.endpoint(), found.folder) == ("mine", LAB, None)
    there = reach("runs/mine", LAB)
    assert there.endpoint() == LAB
    assert there.folder is not None
    assert there.folder.path == folder.path
    with pytest.raises(RunFolderError, match="neither a run's folder nor a run's name"):
        reach("Some Run", LAB)
    with pytest.raises(NotRunning, match="name the one at tls/lab:7447 too"):
        reach(None, LAB)


def test_containers_say_both_in_their_environment(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BABBLE_CONNECT", "tcp/router:7447")
    monkeypatch.setenv("BABBLE_RUN", "cuboid")
    found = reach(None, None)
    assert (found.run, found.endpoint(), found.folder) == ("cuboid", "tcp/router:7447", None)
    assert reach("runs/mine", None).endpoint() == "tcp/router:7447"
    assert reach("other", LAB).endpoint() == LAB
    with folder.locked():
        assert reach("runs/mine", None).endpoint() == "tcp/127.0.0.1:1234", "its launcher knows better"


def test_a_credential_exported_for_other_runs_is_not_in_the_way_of_one_that_needs_none(
    folder: RunFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported, given = Path("certs/launcher.pem"), Path("other.pem")
    monkeypatch.setenv("BABBLE_CREDENTIAL", str(exported))
    with folder.locked():
        here = reach("mine", None)
        assert here.credential(exported) is None
        assert here.credential(given) == given, "what was given by hand is not left out silently"
        folder.note_endpoint("tls/127.0.0.1:1234")
        assert here.credential(exported) == exported
    assert reach("mine", LAB).credential(exported) == exported


@pytest.mark.parametrize("name", ["a" * 300, "~nobody-of-this-name/run", "x/../y", ""])
@pytest.mark.parametrize("connect", [None, LAB])
def test_whatever_is_no_name_is_one_sentence(name: str, connect: str | None) -> None:
    with pytest.raises((RunFolderError, NotRunning)):
        reach(name, connect)
