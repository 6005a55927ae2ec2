"""`live` in a thread and what sends to it, for the tests."""

import random
import socket
import threading
from contextlib import suppress

from stridetwin.cli.main import parse
from stridetwin.streams.errors import StrideTwinError

_PARSING = threading.Lock()
"""Typer sets and deletes an environment variable while it parses: two threads at once would fail."""


def free_port():
    """One that is free now and outside the range from which the system assigns ports."""
    while True:
        port = random.randrange(20_000, 32_000)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def outcome(*words):
    """What a command has to say; its error, where it has one."""
    with _PARSING:
        call = parse([str(w) for w in words])
    try:
        return call.run(lambda *_: None)
    except StrideTwinError as error:
        return error


def alive(words, *senders, port=None):
    """Runs `live` in a thread while each sender does its part with the address; returns what `live` has to say."""
    where = f"127.0.0.1:{port or free_port()}"
    results = []
    live = threading.Thread(target=lambda: results.append(outcome("live", *words, "--listen", where)), daemon=True)
    live.start()
    for send in senders:
        send(where)
    live.join(300)
    assert results, "`live` has not ended"
    return results[0]


def sent(recording, *words):
    """Sends a recording as fast as it is taken."""

    def send(where):
        made = outcome("send", recording, "--to", where, "--speed", "0", "--patience", "240", *words)
        assert not isinstance(made, Exception), made

    return send
