"""Finds a slot and opens a socket toward the controller for a new client."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable

from bcapscope.errors import BcapError
from bcapscope.messages import Message
from bcapscope.messages.os_errors import os_reason
from bcapscope.proxy.admission import ClientSlot
from bcapscope.proxy.relay import Relay
from bcapscope.traffic.observation import Transport
from bcapscope.transport.descriptors import is_out_of_descriptors


class ClientDeniedError(BcapError):
    """The proxy rejects a new client, because there is no slot."""


def open_upstream(
    relay: Relay, transport: Transport, host: str, is_stop: bool, open_socket: Callable[[], socket.socket]
) -> tuple[socket.socket, ClientSlot]:
    """Find a slot for a new client, and open a socket toward the controller. Other clients may be ended for
    the new client.

    Args:
        is_stop: True if the client's first frame is a stop, for which other clients end to free a file
            descriptor.
        open_socket: Function that opens the socket toward the controller.

    Raises:
        ClientDeniedError: There is no slot, or no file descriptor would be left for a stop.
        OSError: The socket cannot be opened.
    """
    slot = relay.slots[transport].find_slot(host, relay.now, is_stop)
    if slot is ClientSlot.NONE:
        raise ClientDeniedError(Message("client.too-many"))
    while True:
        try:
            upstream = open_socket()
            break
        except OSError as error:
            if not is_stop or not is_out_of_descriptors(error) or not relay.free_descriptor():
                raise
    if relay.spares.refill():
        return upstream, slot
    if not is_stop:
        upstream.close()
        raise ClientDeniedError(Message("client.not-accepted", reason=os_reason(OSError(errno.EMFILE, ""))))
    return upstream, ClientSlot.RESERVED
