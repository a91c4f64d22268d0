"""Channel: messages between two processes of one machine; neither waits for the other.

One pickled message is one datagram: it comes whole or not at all, even if the sender is killed or stopped while it
sends. Messages come once, in the order in which they were sent. What does not fit is dropped: the newest, because
messages in the channel stay there until they are taken.
"""

from __future__ import annotations

import pickle
import socket
from collections.abc import Iterator

from elastic_strips.errors import ConfigurationError

_LARGEST_MESSAGE = 1 << 20  # [bytes] of one message


class ChannelClosedError(Exception):
    """The process at the other end is gone."""


def channel(size: int) -> tuple[socket.socket, socket.socket]:
    """Two ends of a channel that holds about ``size`` [bytes] each way.

    Raises:
        ConfigurationError: this system has no such sockets.
    """
    kind = getattr(socket, "SOCK_SEQPACKET", None)
    if kind is None or not hasattr(socket, "AF_UNIX"):
        raise ConfigurationError("processes need Unix sockets with SOCK_SEQPACKET (Linux); drive without realtime")
    ends = socket.socketpair(socket.AF_UNIX, kind)
    for end in ends:
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size)
        end.setblocking(False)
    return ends


def put(end: socket.socket, message: object) -> bool:
    """Send a message; False where the channel is full or closed, or the other end is gone."""
    try:
        end.send(pickle.dumps(message, pickle.HIGHEST_PROTOCOL), socket.MSG_DONTWAIT)
    except OSError:
        return False
    return True


def take(end: socket.socket) -> Iterator[object]:
    """The messages that have come.

    Raises:
        ChannelClosedError: the other end is gone, and nothing is left.
        Exception: whatever unpickling throws; later messages are left for the next call.
    """
    while True:
        try:
            data = end.recv(_LARGEST_MESSAGE, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except ConnectionResetError:  # told once where the other end left something unread; what it sent comes after it
            continue
        except OSError as error:
            raise ChannelClosedError from error
        if not data:
            raise ChannelClosedError
        yield pickle.loads(data)
