"""The operator's folder of certificates: who may join, and what signs it.

    ca.key, ca.pem          the authority; the key stays here
    <identity>.pem          one credential each
    router/router.pem       the router's
    router/hosts            the labels of the hosts whose actors may connect; the router reads it anew
    revoked                 labels that are never given again

Whatever holds a private key is readable by its owner only. A file is there whole or not at all.
"""

import contextlib
import fcntl
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509

from services.launcher.authority import (
    CREDENTIAL_DAYS,
    Authority,
    issue,
    load_authority,
    make_authority,
    names_of,
)
from services.runtime.checkpoint import sync_folder
from services.runtime.credentials import (
    ACTOR,
    HOST_PATTERN,
    ROLES,
    ROUTER,
    CredentialError,
    load_credential,
    role_and_host,
)
from services.runtime.errors import UserError

CA_KEY, CA_PEM, ROUTER_PEM, HOSTS, REVOKED = (
    "ca.key",
    "ca.pem",
    "router/router.pem",
    "router/hosts",
    "revoked",
)
LOCAL = "local"
"""The host label of the actors beside the router."""
FIRST_ROLES = ("coordinator", "encoder_learner", "policy_learner", "dashboard", "launcher", "recorder")
PRIVATE, PUBLIC, FOLDER = 0o600, 0o644, 0o700

Owner = tuple[int, int]
"""User and group, as numbers."""


class CertsError(UserError):
    """Something about a folder of certificates that a person must mend; the text is one sentence."""


@dataclass(frozen=True)
class Held:
    """A credential that the folder should hold, as far as it can be read."""

    identity: str
    path: Path
    not_after: datetime | None = None
    """When it expires; None if it cannot be read."""
    problem: str = ""


class CertsFolder:
    """A folder with an authority, the credentials it signed, and which hosts may connect."""

    def __init__(self, path: Path, owner: Owner | None = None) -> None:
        """`owner` (which only root may choose) gets the credentials that are made.

        Without one, root gives them to whom the router's belongs. Raises `CertsError` if the folder
        is not there, or not whole.
        """
        self.path = path
        _check_whole(path)
        self._owner = owner
        if owner is None and os.geteuid() == 0:
            router = (path / ROUTER_PEM).stat()
            self._owner = (router.st_uid, router.st_gid)

    @classmethod
    def create(
        cls, path: Path, names: Sequence[str], *, days: int = CREDENTIAL_DAYS, owner: Owner | None = None
    ) -> "CertsFolder":
        """A new authority in a new folder, with a credential for each role and for the local actors.

        `names`: by which others reach the router. Raises `CertsError` if anything is there already.
        """
        with _told(path):
            for folder in (path, path / ROUTER):
                folder.mkdir(mode=FOLDER, parents=True, exist_ok=True)
                if any(folder.iterdir()):
                    raise CertsError(_why_not_here(path))
                folder.chmod(FOLDER)
            if owner is not None:
                os.chown(path / ROUTER, *owner)
            authority = make_authority()
            _write(path / CA_KEY, authority.key_pem, PRIVATE)
            _write(path / CA_PEM, authority.certificate_pem, PUBLIC)
            for identity in (*FIRST_ROLES, f"{ACTOR}.{LOCAL}"):
                _write(path / f"{identity}.pem", issue(authority, identity, days=days), PRIVATE, owner)
            _write(path / ROUTER_PEM, issue(authority, ROUTER, names=names, days=days), PRIVATE, owner)
            # The last one: without it the folder is not whole.
            _write(path / HOSTS, _text([LOCAL]), PUBLIC, owner)
        return cls(path, owner)

    @property
    def hosts(self) -> list[str]:
        """The labels of the hosts whose actors may connect."""
        return [label for line in self._lines(HOSTS) if (label := _label(line))]

    @property
    def revoked(self) -> list[str]:
        """The labels that were revoked."""
        return self._lines(REVOKED) if (self.path / REVOKED).exists() else []

    @property
    def router_names(self) -> list[str]:
        """By which others reach the router, the operator's own names first. Raises `CertsError`."""
        path = self.path / ROUTER_PEM
        with _told(path):
            held = path.read_bytes()
        try:
            return names_of(held)
        except ValueError:
            raise CertsError(
                f"{path} is damaged, so the router's names are unknown; say them again with "
                "`babble certs renew router --host NAME`"
            ) from None

    def path_of(self, identity: str) -> Path:
        """Where the credential of the identity is, or would be."""
        return self.path / (ROUTER_PEM if identity == ROUTER else f"{identity}.pem")

    def held(self) -> list[Held]:
        """What the folder holds or should hold: roles, then actors, with what is wrong with each.

        Raises `CertsError` if the folder cannot be read.
        """
        usual = (ROUTER, *FIRST_ROLES)
        with _told(self.path):
            roles = [role for role in ROLES if role in usual or self.path_of(role).exists()]
            names = {path.name.removesuffix(".pem") for path in self.path.glob(f"{ACTOR}.*.pem")}
            actors = {name for name in names if role_and_host(name)}
            actors |= {f"{ACTOR}.{host}" for host in self.hosts}
            return [self._held(identity) for identity in (*roles, *sorted(actors))]

    def add(self, host: str, *, days: int = CREDENTIAL_DAYS) -> Held:
        """Admit a host: its credential, and its label in the router's list. Raises `CertsError`."""
        identity = f"{ACTOR}.{host}"
        path = self.path_of(identity)
        if not re.fullmatch(HOST_PATTERN, host):
            raise CertsError(
                f"{host!r} cannot be the label of a host; take 1 to 24 of a-z, 0-9 and _ (no hyphen, as it "
                f"ends the host in the names actor-HOST-1a2b3c4d), for example {_suggestion(host)}"
            )
        with self._changing():
            if why := self._why_not(host):
                raise CertsError(f"{why}, or take another label, for example {host[:22]}_2")
            _write(path, issue(self._authority(), identity, days=days), PRIVATE, self._owner)
            self._write_hosts([*self._lines(HOSTS), host])
        return self._held(identity)

    def renew(self, identity: str, *, days: int = CREDENTIAL_DAYS, names: Sequence[str] = ()) -> Held:
        """A new key and certificate for an identity. Raises `CertsError`.

        `names`: the router's, where they change. The old credential stays good until it expires.
        """
        named = role_and_host(identity)
        known = named is not None and (identity in ROLES or named[1] in self.hosts)
        if not known:
            raise CertsError(
                f"there is no {identity!r} in {self.path}; see who there is with `babble certs list`, or "
                "admit a host with `babble certs add HOST`"
            )
        if identity == ROUTER and not names:
            names = self.router_names
        with self._changing():
            made = issue(self._authority(), identity, names=names, days=days)
            _write(self.path_of(identity), made, PRIVATE, self._owner)
        return self._held(identity)

    def revoke(self, host: str) -> None:
        """Take a host out of the router's list, for good, and delete its credential. Raises `CertsError`."""
        with self._changing():
            if host not in self.hosts and host in ROLES:
                raise CertsError(
                    f"{host} is a role, and only hosts can be revoked; make a new authority in another "
                    "folder with `babble certs init`, and give all processes their new credentials"
                )
            if host not in self.hosts:
                known = ", ".join(self.hosts) or "none"
                raise CertsError(f"{host} is no host of {self.path}; the hosts there are: {known}")
            _write(self.path / REVOKED, _text([*self.revoked, host]), PUBLIC)
            self._write_hosts([line for line in self._lines(HOSTS) if _label(line) != host])
            self.path_of(f"{ACTOR}.{host}").unlink(missing_ok=True)

    def authority_end(self) -> datetime:
        """When the authority expires, and all it signed. Raises `CertsError`."""
        path = self.path / CA_PEM
        with _told(path):
            held = path.read_bytes()
        try:
            return x509.load_pem_x509_certificate(held).not_valid_after_utc
        except ValueError:
            raise CertsError(f"{path} is damaged; bring it back from a copy") from None

    def _why_not(self, host: str) -> str:
        """What stands against adding a host, and what to do; "" if nothing does."""
        path = self.path_of(f"{ACTOR}.{host}")
        if host in self.revoked:
            return f"{host} was revoked, and its old credential would be admitted again; leave it out"
        if host in self.hosts:
            return (
                f"{host} is a host of {self.path} already; renew its credential with "
                f"`babble certs renew {ACTOR}.{host}`"
            )
        if path.exists():
            return f"{path} is there, but {host} is not in {HOSTS}; write the line {host} there again"
        return ""

    def _held(self, identity: str) -> Held:
        path = self.path_of(identity)
        if not path.exists():
            return Held(identity, path, problem="not here")
        try:
            credential = load_credential(path)
        except CredentialError as error:
            return Held(identity, path, problem=str(error))
        problem = ""
        if credential.identity != identity:
            problem = f"is the credential of {credential.identity}"
        elif credential.authority_pem.strip() != (self.path / CA_PEM).read_bytes().strip():
            problem = "signed by another authority"
        elif credential.role == ACTOR and credential.host not in self.hosts:
            problem = "not admitted: not in router/hosts"
        return Held(identity, path, credential.not_after, problem)

    def _authority(self) -> Authority:
        path = self.path / CA_KEY
        if not path.exists():
            raise CertsError(f"{path} is not here, and only it can sign credentials; bring it back first")
        with _told(path):
            certificate_pem, key_pem = (self.path / CA_PEM).read_bytes(), path.read_bytes()
        try:
            authority = load_authority(certificate_pem, key_pem)
        except ValueError:
            raise CertsError(
                f"{path} is damaged, or is not the key of {CA_PEM}; bring both back from a copy"
            ) from None
        end = authority.certificate.not_valid_after_utc
        if end <= datetime.now(UTC):
            raise CertsError(
                f"the authority in {self.path} expired on {end:%Y-%m-%d}; make a new one in another folder "
                "with `babble certs init`, and give all processes their new credentials"
            )
        return authority

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """Alone: of two that add a host at once, one would be forgotten."""
        with _told(self.path):
            handle = os.open(self.path / CA_PEM, os.O_RDWR)
            try:
                try:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    raise CertsError(
                        f"another `babble certs` is changing {self.path}; try again when it has ended"
                    ) from None
                yield
            finally:
                os.close(handle)

    def _lines(self, name: str) -> list[str]:
        with _told(self.path / name):
            return (self.path / name).read_text(encoding="utf-8", errors="replace").splitlines()

    def _write_hosts(self, lines: Sequence[str]) -> None:
        _write(self.path / HOSTS, _text(lines), PUBLIC, self._owner)


def _why_not_here(path: Path) -> str:
    """Why there can be no new authority in a folder with something in it. Raises `CertsError` if half one."""
    if not _there(path):
        return f"{path} is not empty; give --dir a folder that is new or empty"
    _check_whole(path)
    return (
        f"{path} holds an authority already, which is never overwritten; go on with it (`babble certs add`, "
        "`renew`), or give --dir another folder"
    )


def _there(path: Path) -> list[str]:
    with _told(path):
        return [name for name in (CA_KEY, CA_PEM, ROUTER_PEM, HOSTS) if (path / name).is_file()]


def _check_whole(path: Path) -> None:
    there = _there(path)
    missing = [name for name in (CA_PEM, ROUTER_PEM, HOSTS) if name not in there]
    if not there:
        raise CertsError(
            f"there is no authority in {path}; say with --dir where it is, or make one with "
            "`babble certs init --host NAME`"
        )
    if missing:
        raise CertsError(
            f"{path} is not whole: it lacks {' and '.join(missing)}; bring back what was lost, or, if "
            "`babble certs init` was interrupted, delete the folder and start it again"
        )


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    """Refusals of the disk, as one sentence."""
    try:
        yield
    except OSError as error:
        what = error.filename or path
        raise CertsError(
            f"cannot use {what}: {error.strerror or error}; see to whom it belongs and whether there is room"
        ) from None


def _write(path: Path, data: bytes, mode: int, owner: Owner | None = None) -> None:
    """Replace a file at once, never readable by more than `mode` says. Raises OSError."""
    draft = path.with_name(f".{path.name}.{secrets.token_hex(4)}.draft")
    try:
        handle = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE)
        with open(handle, "wb") as file:
            file.write(data)
            os.fchmod(handle, mode)
            if owner is not None:
                os.fchown(handle, *owner)
            file.flush()
            os.fsync(handle)
        draft.replace(path)
        sync_folder(path.parent)
    finally:
        draft.unlink(missing_ok=True)


def _label(line: str) -> str:
    """The host of a line of router/hosts, which an operator may edit and comment on; "" if none."""
    return line.partition("#")[0].strip()


def _text(lines: Sequence[str]) -> bytes:
    return "".join(f"{line}\n" for line in lines).encode()


def _suggestion(label: str) -> str:
    return re.sub("[^a-z0-9_]+", "_", label.lower())[:24].strip("_") or "lab"
