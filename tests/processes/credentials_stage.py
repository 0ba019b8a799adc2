"""What the tests of the closed door share: credentials in a folder, a router behind TLS, and attackers.

The attacker is a program of its own with a raw Zenoh session, since a `ZenohBus` would not misbehave.
"""

from collections.abc import Collection
from datetime import datetime
from pathlib import Path

from services.launcher.authority import Authority, issue, make_authority
from services.runtime.credentials import Credential, read_credential
from tests.processes.owned import Owner, Process, free_port

HERE = ("localhost", "127.0.0.1")

_SESSION = '''
import base64, json, re, sys, time
from pathlib import Path
import zenoh, zenoh.ext

def encoded(path, label):
    held = Path(path).read_bytes() if path else b""
    found = re.findall(rb"-----BEGIN [A-Z ]*" + label + rb"-----.*?-----END [A-Z ]*-----", held, re.DOTALL)
    return [base64.b64encode(block).decode() for block in found]

def opened(endpoint, credential, mode):
    """A session as a thief would open it: what is in the file is shown, whole or not."""
    private, certificates = encoded(credential, b"PRIVATE KEY"), encoded(credential, b"CERTIFICATE")
    side = "listen" if mode == "impostor" else "connect"
    tls = {"enable_mtls": bool(private)}
    if certificates:
        tls["root_ca_certificate_base64"] = certificates[-1]
    if private:
        tls[f"{side}_private_key_base64"], tls[f"{side}_certificate_base64"] = private[0], certificates[0]
    settings = {
        "mode": "router" if mode == "impostor" else mode,
        "connect/endpoints": [endpoint] if side == "connect" else [],
        "listen/endpoints": [endpoint] if side == "listen" else [],
        "connect/timeout_ms": 3000,
        "scouting/multicast/enabled": False,
        "transport/link/protocols": [endpoint.split("/")[0]],
        "transport/link/tls": tls,
    }
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)
'''

STRANGER = (
    _SESSION
    + """
try:
    session = opened(*sys.argv[1:])
except zenoh.ZError:
    print("refused", flush=True)
    sys.exit()
print("listening", flush=True)
session.put("babble/r/status/actor/actor-lab-1", b"forged")
print("said", flush=True)
while session.info.routers_zid():
    session.put("babble/r/status/actor/actor-lab-1", b"forged")
    time.sleep(0.01)
print("cut off", flush=True)
time.sleep(60)
"""
)
"""Opens a session with whatever it has, and goes on saying what it should not until it is cut off."""

ATTACKER = (
    _SESSION
    + """
endpoint, credential, mode, verb, key = sys.argv[1:]
session = opened(endpoint, credential, mode)
held = []

def heard(what):
    print("HEARD", what.key_expr, flush=True)

def answer(query):
    print("ASKED", query.key_expr, flush=True)
    with query:
        query.reply(query.key_expr, b"forged")

def recall(selector):
    anything = zenoh.ReplyKeyExpr.ANY
    for reply in session.get(selector, timeout=2.0, accept_replies=anything, target=zenoh.QueryTarget.ALL):
        if reply.ok is not None:
            print("HEARD", reply.ok.key_expr, flush=True)

def retain(key):
    held.append(zenoh.ext.declare_advanced_publisher(
        session, key, cache=zenoh.ext.CacheConfig(max_samples=1), publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=0.1, sporadic_heartbeat=None)))
    held[-1].put(b"forged")

# On the thread that receives, so that a print comes before the next answer at the door.
def at_once(callback):
    return zenoh.handlers.Callback(callback, indirect=False)

REMOTE = zenoh.Locality.REMOTE
{
    "says": lambda: session.put(key, b"forged"),
    "deletes": lambda: session.delete(key),
    "retains": lambda: retain(key),
    "announces": lambda: held.append(session.liveliness().declare_token(key)),
    "hears": lambda: held.append(session.declare_subscriber(key, at_once(heard), allowed_origin=REMOTE)),
    "watches": lambda: held.append(
        session.liveliness().declare_subscriber(key, at_once(heard), history=True)),
    "asks": lambda: recall(key),
    "answers": lambda: held.append(session.declare_queryable(key, at_once(answer))),
}[verb]()
print("done", flush=True)
rounds = 0
while True:
    for reply in session.get("babble/@door", timeout=2.0):
        rounds += 1
        print("door", rounds, flush=True)
    if verb in ("hears", "asks"):
        recall(key)
    time.sleep(0.05)
"""
)
"""Does one thing, prints "done", and then asks at the router's door again and again: each answer proves
that the router has taken everything before it. Prints whatever reaches it."""


def stranger(owner: Owner, endpoint: str, credential: Path | None, mode: str) -> Process:
    """Starts `STRANGER`, as a "client", or as an "impostor": a router of its own at the endpoint."""
    return owner.start_code("stranger", STRANGER, endpoint, str(credential or ""), mode)


class CredentialsStage:
    """An authority, and credentials of it in a folder of the test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.authority = make_authority()
        self._made = 0

    def path(
        self,
        identity: str,
        *,
        names: Collection[str] = HERE,
        not_after: datetime | None = None,
        authority: Authority | None = None,
    ) -> Path:
        """A new file of its own; `names` are those of the router alone."""
        of_router = [*names] if identity == "router" else []
        made = issue(authority or self.authority, identity, names=of_router, not_after=not_after)
        self._made += 1
        path = self.folder / f"{identity}-{self._made}.pem"
        path.write_bytes(made)
        return path

    def credential(
        self, identity: str, *, not_after: datetime | None = None, authority: Authority | None = None
    ) -> Credential:
        """A new credential, read as a process would."""
        return read_credential(self.path(identity, not_after=not_after, authority=authority))

    def router(
        self, owner: Owner, hosts: Collection[str], *, names: Collection[str] = HERE
    ) -> "GuardedRouter":
        """A router behind TLS on a free port, which lets in the actors of these hosts.

        It tolerates garbage: what tests say are words and no frames.
        """
        listed = self.folder / "hosts"
        listed.write_text("".join(f"{host}\n" for host in hosts))
        shown = self.path("router", names=names)
        options = {"--credential": str(shown), "--hosts": str(listed), "--most-garbage": "1000000"}
        return GuardedRouter(owner, listed, *[word for option in options.items() for word in option])


class GuardedRouter:
    """A router process behind TLS with access control, ready; it can be killed and started again."""

    def __init__(self, owner: Owner, hosts: Path, *options: str) -> None:
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        self.hosts = hosts
        """the file with the labels of the hosts"""
        self._owner = owner
        self._options = options
        self.start_again()

    def start_again(self) -> None:
        """A new process at the same address, ready."""
        self.process = self._owner.start_service("router", "--listen", self.endpoint, *self._options)
        self.process.expect("ready")
