"""What is answered to a request for a path: a table of what can be had, and nothing from the request else.

The viewer's files may come later than the first request: until then the page is told that they are
being made ready, or why they cannot be.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from email.message import Message
from http import HTTPStatus
from pathlib import Path

from services.dashboard.pages import Hosts, media_type, page, security_headers, stream_host
from services.dashboard.salvage import RecordingError, measure
from services.dashboard.viewer_files import NAMES, ViewerFile, ViewerFiles

FOR_EVER = "public, max-age=31536000, immutable"
ASK_AGAIN = "no-cache"
NEVER_KEEP = "no-store"
METHODS = ("GET", "HEAD")
WASM = "re_viewer_bg.wasm"
ICON = "favicon.ico"


@dataclass(frozen=True)
class Stored:
    """The first `size_bytes` of a file."""

    path: Path
    size_bytes: int


@dataclass(frozen=True)
class Packed:
    """Gzipped contents, for a browser that wants them unpacked: `size_bytes` of them."""

    gzipped: bytes
    size_bytes: int


Body = bytes | Stored | Packed


@dataclass(frozen=True)
class Answer:
    """One HTTP answer; the length, and the headers that all have, are the server's matter."""

    body: Body = b""
    status: HTTPStatus = HTTPStatus.OK
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def size_bytes(self) -> int:
        """Bytes of the body."""
        return len(self.body) if isinstance(self.body, bytes) else self.body.size_bytes


class Answers:
    """Answers for one run: a live stream at `grpc_port`, or recordings if that is None."""

    def __init__(
        self, hosts: Hosts, run: str, life: str, grpc_port: int | None, recordings: Sequence[Path]
    ) -> None:
        self._hosts = hosts
        self._run, self._life, self._grpc_port = run, life, grpc_port
        self._page = page(run)
        self._recordings = {f"/recording/{path.name}": path for path in recordings}
        self.viewer: ViewerFiles | None = None
        """Set once, when the viewer's files are ready."""
        self.error = ""
        """Why they never will be; one sentence."""

    def answer(self, method: str, target: str, headers: Message) -> Answer:
        """The answer to `method target` with these headers."""
        host = self._hosts.of_request(headers.get("Host", ""))
        if host is None:
            return self._not_ours()
        if method not in METHODS:
            refused = _text(HTTPStatus.METHOD_NOT_ALLOWED, "here is only something to read")
            return Answer(refused.body, refused.status, {**refused.headers, "Allow": ", ".join(METHODS)})
        found = self._find(target.partition("?")[0], host, headers)
        tag = found.headers.get("ETag")
        if tag is not None and tag in _tags(headers.get("If-None-Match", "")):
            found = Answer(b"", HTTPStatus.NOT_MODIFIED, found.headers)
        return Answer(found.body, found.status, {**found.headers, **security_headers(host, self._grpc_port)})

    def _find(self, path: str, host: str, headers: Message) -> Answer:
        if path == "/run":
            told = json.dumps(self._told(host)).encode()
            return Answer(told, headers=_headers("run.json", NEVER_KEEP))
        if path in self._page:
            contents = self._page[path]
            tag = hashlib.sha256(contents).hexdigest()[:16]
            return Answer(contents, headers=_headers(path, ASK_AGAIN, tag))
        if path in self._recordings:
            return _recording(self._recordings[path])
        if self.viewer is not None:
            if path == f"/{ICON}":
                return _viewer_file(ICON, self.viewer.files[ICON], headers, ASK_AGAIN)
            folder, _, name = path.rpartition("/")
            if f"{folder}/" == self._viewer_folder() and name in NAMES:
                return _viewer_file(name, self.viewer.files[name], headers, FOR_EVER)
        return _text(HTTPStatus.NOT_FOUND, "nothing is served under this address")

    def _told(self, host: str) -> dict[str, str | int | list[str]]:
        """What the page is told of the run: which process serves it, and what to show."""
        stream = "" if self._grpc_port is None else f"http://{stream_host(host)}:{self._grpc_port}"
        return {
            "run": self._run,
            "life": self._life,
            "error": self.error,
            "viewer": self._viewer_folder(),
            "wasm_bytes": 0 if self.viewer is None else self.viewer.files[WASM].raw_bytes,
            "sources": [f"rerun+{stream}/proxy"] if stream else [*self._recordings],
            "probe": f"{stream}/" if stream else "",
        }

    def _viewer_folder(self) -> str:
        """Named by what is in it, so that a browser may keep it for ever."""
        return "" if self.viewer is None else f"/viewer/{self.viewer.digest}/"

    def _not_ours(self) -> Answer:
        names = ", ".join(sorted(self._hosts.names))
        return _text(
            HTTPStatus.MISDIRECTED_REQUEST,
            f"this page can be opened under these host names only: {names}; "
            "start it with --allow-origin http://NAME:PORT to open it under another",
        )


def _recording(path: Path) -> Answer:
    """A recording up to its last whole message, as it is now."""
    try:
        whole = measure(path)
    except RecordingError as error:
        return _text(HTTPStatus.NOT_FOUND, str(error))
    return Answer(Stored(path, whole.whole_bytes), headers=_headers(path.name, NEVER_KEEP))


def _viewer_file(name: str, file: ViewerFile, headers: Message, keep: str) -> Answer:
    """A file of the viewer, gzipped if the browser takes that."""
    packed = _takes_gzip(headers.get("Accept-Encoding", ""))
    tag = f"{file.sha256[:16]}-gzip" if packed else file.sha256[:16]
    about = {**_headers(name, keep, tag), "Vary": "Accept-Encoding"}
    if packed:
        return Answer(file.gzipped, headers={**about, "Content-Encoding": "gzip"})
    return Answer(Packed(file.gzipped, file.raw_bytes), headers=about)


def _text(status: HTTPStatus, sentence: str) -> Answer:
    return Answer(f"{sentence}\n".encode(), status, _headers("answer.txt", NEVER_KEEP))


def _headers(name: str, keep: str, tag: str = "") -> dict[str, str]:
    about = {"Content-Type": media_type(name), "Cache-Control": keep}
    return {**about, "ETag": f'"{tag}"'} if tag else about


def _tags(header: str) -> list[str]:
    return [tag.strip().removeprefix("W/") for tag in header.split(",")]


def _takes_gzip(header: str) -> bool:
    """Whether an Accept-Encoding names gzip, and not with a weight of 0."""
    for coding in header.lower().split(","):
        name, _, parameters = coding.partition(";")
        if name.strip() in ("gzip", "*"):
            weight = parameters.strip().removeprefix("q=")
            return weight.strip("0.") != "" or weight == ""
    return False
