"""This process's own TCP connections, as the kernel knows them: who, how many bytes, and how to end them.

Zenoh tells which connection has which certificate, but neither counts its bytes nor closes it. The
sockets are this process's own, so it may ask the kernel.
"""

import contextlib
import ctypes
import ipaddress
import os
import resource
import socket
import stat
import struct
import sys
from dataclasses import dataclass, field

FOLDER = "/proc/self/fd" if os.path.isdir("/proc/self/fd") else "/dev/fd"
COUNTS_BYTES = sys.platform == "linux"
"""False where the kernel does not say how much a connection received."""
TCP_INFO_BYTES = 136
BYTES_RECEIVED_OFFSET = 128
"""of `tcpi_bytes_received`, 64 bits, in struct tcp_info (linux/tcp.h; since Linux 4.1)"""
MOST_FILES = 65536
SO_ATTACH_FILTER = 26
"""asm-generic/socket.h; Python does not name it"""
NO_LINGER = struct.pack("@ii", 1, 0)
"""Zenoh lets sockets linger: closing one whose other end takes nothing would hold up a thread for 10 s."""

Peer = tuple[str, int]
"""The other end: address and port."""


class _Instruction(ctypes.Structure):
    """One of a socket filter (struct sock_filter, linux/filter.h)."""

    _fields_ = (
        ("code", ctypes.c_uint16),
        ("jump_true", ctypes.c_uint8),
        ("jump_false", ctypes.c_uint8),
        ("value", ctypes.c_uint32),
    )


_DROP_ALL = _Instruction(0x06, 0, 0, 0)
"""Return 0: of each packet 0 bytes are let through."""


@dataclass
class Connection:
    """One TCP connection."""

    received_bytes: int = 0
    files: list[int] = field(default_factory=list)
    """The descriptors of its socket."""


def connections() -> dict[Peer, Connection]:
    """The TCP connections of this process, by their other ends."""
    found: dict[Peer, Connection] = {}
    for name in os.listdir(FOLDER):
        with contextlib.suppress(OSError), _borrowed(int(name)) as own:
            connection = found.setdefault(_peer(own), Connection())
            connection.received_bytes = _received(own)
            connection.files.append(int(name))
    return found


def cut(peer: Peer, connection: Connection) -> bool:
    """Shut a connection of `connections()` down, both ways; True if it was there still.

    The transport notices and tidies up. A descriptor that has become another one's is left alone.
    """
    done = False
    for file in connection.files:
        with contextlib.suppress(OSError), _borrowed(file) as own:
            if _peer(own) == peer:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
                own.shutdown(socket.SHUT_RDWR)
                done = True
    return done


def hurry() -> None:
    """Let no connection of this process linger when it is closed."""
    for connection in connections().values():
        for file in connection.files:
            with contextlib.suppress(OSError), _borrowed(file) as own:
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)


def mute(peer: Peer) -> bool:
    """Let the kernel drop all that comes on a connection from now on; True if it does.

    Whoever is at the other end of a connection that is cut comes back at once, and says much before he is
    cut again; one who is not heard stays and waits.
    """
    if sys.platform != "linux":
        return False
    # Of many, the newest have the highest numbers; one descriptor of the socket will do.
    for file in sorted(map(int, os.listdir(FOLDER)), reverse=True):
        with contextlib.suppress(OSError), _borrowed(file) as own:
            if _peer(own) == peer:
                program = struct.pack("@HP", 1, ctypes.addressof(_DROP_ALL))
                own.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, NO_LINGER)
                own.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, program)
                return True
    return False


def peer_of(host: str, port: int) -> Peer:
    """One spelling for an address, whoever wrote it: no brackets, no zone, IPv4 as itself."""
    plain = host.strip("[]").partition("%")[0]
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(plain)
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        plain = str(mapped or address)
    return plain, port


def allow_many() -> None:
    """Let this process have as many connections as it may, so that one client cannot take them all."""
    least, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_FILES if most == resource.RLIM_INFINITY else min(MOST_FILES, most)
    if least != resource.RLIM_INFINITY and least < wanted:
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))


def _borrowed(file: int) -> socket.socket:
    """A TCP socket of its own for a descriptor. Raises OSError if it is none."""
    if not stat.S_ISSOCK(os.fstat(file).st_mode):
        raise OSError("not a socket")
    own = socket.socket(fileno=os.dup(file))
    if own.family not in (socket.AF_INET, socket.AF_INET6) or own.type != socket.SOCK_STREAM:
        own.close()
        raise OSError("not a TCP socket")
    return own


def _peer(own: socket.socket) -> Peer:
    address = own.getpeername()
    return peer_of(address[0], address[1])


def _received(own: socket.socket) -> int:
    if not COUNTS_BYTES:
        return 0
    told = own.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES)
    if len(told) < TCP_INFO_BYTES:
        return 0
    return int(struct.unpack_from("=Q", told, BYTES_RECEIVED_OFFSET)[0])
