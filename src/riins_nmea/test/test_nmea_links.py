"""Addresses, UDP over loopback (unicast and multicast), a serial line as a pseudo-terminal, a line that breaks.

Lives here: links.py with real sockets.
Does not live here: what the bytes mean (test_nmea_aids.py).
"""

from __future__ import annotations

import builtins
import contextlib
import os
import pty
import select
import socket
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest

from riins_core.settings import SettingError
from riins_nmea.links import LinkError, Receiver, Sender, SerialLine, SerialLines, parse_link

TEXT = "$INTHS,30.00,A*1C\r\n"


def until(condition: Callable[[], object], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.005)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def terminal() -> tuple[int, str, int]:
    """Our end of a pseudo-terminal, the path of the other, and that one held open as a device is."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    return ours, os.ttyname(theirs), theirs


@pytest.mark.parametrize(
    ("text", "output", "message"),
    [
        ("10.0.0.1:10110", True, "udp://HOST:PORT"),
        ("udp://10.0.0.1", True, "udp://HOST:PORT"),
        ("udp://10.0.0.1:99999", True, "no address"),
        ("tcp://10.0.0.1:1", True, "udp://HOST:PORT"),
        ("udp://ship.example:10110", False, "0.0.0.0 listens"),
        ("udp://239.0.0.1:10110?hops=3", True, "ttl=0..255"),
        ("udp://239.0.0.1:10110?ttl=300", True, "ttl=0..255"),
        ("udp://239.0.0.1:10110?interface=eth0", True, "IPv4"),
        ("serial://", True, "serial:///dev/NAME"),
        ("serial://ttyUSB0?baud=4800", True, "serial:///dev/NAME"),
        ("serial:///dev/ttyUSB0?baud=4801", True, "baud rate must be one of"),
        ("serial:///dev/ttyUSB0?parity=odd", True, "serial:///dev/NAME"),
    ],
)
def test_a_wrong_address_is_one_line(text: str, output: bool, message: str) -> None:
    with pytest.raises(SettingError, match=message) as error:
        parse_link(text, output)
    assert "\n" not in str(error.value)


def test_addresses() -> None:
    assert parse_link("udp://255.255.255.255:10110", True).host == "255.255.255.255"
    group = parse_link("udp://239.192.0.1:60001?interface=127.0.0.1&ttl=4", False)
    assert group.multicast and (group.interface, group.ttl) == ("127.0.0.1", 4) and not parse_link("udp://10.0.0.1:1", True).multicast
    assert (parse_link("serial:///dev/ttyUSB0", True).baud, parse_link("serial:///dev/a?baud=38400", False).baud) == (4800, 38400)


@pytest.mark.parametrize("address", ["udp://127.0.0.1:{}", "udp://239.192.7.9:{}?interface=127.0.0.1"])
def test_udp_out_is_udp_in(address: str) -> None:
    """Each sentence is one datagram, whole; what is not for this port is not heard."""
    heard: list[tuple[str, bytes, bool]] = []
    lines, text = SerialLines(), address.format(free_port())
    receiver = Receiver([parse_link(text, False)], lines, lambda *all_: heard.append(all_))
    sender = Sender(parse_link(text, True), lines)
    try:
        sender.send([TEXT, TEXT])
        until(lambda: len(heard) == 2)
        assert heard == [(text, TEXT.encode(), True)] * 2 and (sender.sent, sender.failed, sender.problem) == (2, 0, "")
    finally:
        receiver.close()
        sender.close()


def test_a_taken_port_an_unknown_host_and_a_refused_datagram_are_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        with pytest.raises(LinkError, match="cannot be listened to: another program, or another nmea node, listens there"):
            Receiver([parse_link(f"udp://127.0.0.1:{one.getsockname()[1]}", False)], SerialLines(), lambda *_: None)
    for address, shared in (("udp://0.0.0.0:{}", False), ("udp://239.192.7.9:{}?interface=127.0.0.1", True)):
        link = parse_link(address.format(free_port()), False)
        first = Receiver([link], SerialLines(), lambda *_: None)
        try:
            with contextlib.nullcontext() if shared else pytest.raises(LinkError, match="another nmea node"):
                Receiver([link], SerialLines(), lambda *_: None).close()
        finally:
            first.close()
    for host in ("ship.invalid", "a..b", "x" * 70 + ".invalid"):
        with pytest.raises(LinkError, match="is not known"):
            Sender(parse_link(f"udp://{host}:9", True), SerialLines())
    sender = Sender(parse_link("udp://127.0.0.1:9", True), SerialLines())
    sender.send(["$" + "x" * 70000])  # the kernel refuses it
    assert (sender.sent, sender.failed) == (0, 1) and "udp://127.0.0.1:9" in sender.problem
    sender.send([TEXT])
    assert sender.sent == 1 and sender.problem == ""
    sender.close()


def test_one_serial_line_for_both_directions() -> None:
    pytest.importorskip("serial")
    ours, path, theirs = terminal()
    heard: list[bytes] = []
    lines = SerialLines()
    receiver = Receiver([parse_link(f"serial://{path}?baud=38400", False)], lines, lambda _, data, end: heard.append(data) or None)
    sender = Sender(parse_link(f"serial://{path}?baud=38400", True), lines)
    try:
        sender.send([TEXT])
        assert select.select([ours], [], [], 5.0)[0] and os.read(ours, 100) == TEXT.encode()
        os.write(ours, TEXT.encode())
        until(lambda: b"".join(heard) == TEXT.encode())
        with pytest.raises(LinkError, match="with 38400 and with 4800 baud"):
            lines.line(parse_link(f"serial://{path}", False))
    finally:
        receiver.close()
        lines.close()
        os.close(ours)
        os.close(theirs)


def test_a_line_too_slow_leaves_out_whole_sentences() -> None:
    """Nobody reads: sentences are counted as not sent, and what was sent is whole."""
    pytest.importorskip("serial")
    ours, path, theirs = terminal()
    lines = SerialLines()
    sender = Sender(parse_link(f"serial://{path}?baud=4800", True), lines)
    sender.send([TEXT] * 2000)
    assert sender.failed > 0 and sender.sent + sender.failed == 2000 and "too slow" in sender.problem
    got = b""
    while len(got) < len(TEXT) * sender.sent:
        got += os.read(ours, 65536) if select.select([ours], [], [], 1.0)[0] else b""
        lines.line(sender.link).write(b"")  # the backlog goes with the next sentence
    assert got == TEXT.encode() * sender.sent
    lines.close()
    os.close(ours)
    os.close(theirs)


def test_a_device_that_is_not_there_and_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Told in one line while it is away; used when it has come; unplugged, it is told again, and nothing raises."""
    pytest.importorskip("serial")
    monkeypatch.setattr("riins_nmea.links._RETRY_S", 0.0)
    ours, path, theirs = terminal()
    device = tmp_path / "gyro"
    heard: list[bytes] = []
    lines = SerialLines()
    receiver = Receiver([parse_link(f"serial://{device}", False)], lines, lambda _, data, end: heard.append(data) or None)
    try:
        until(lambda: receiver.problems)
        assert "gyro cannot be opened" in receiver.problems[0] and "\n" not in receiver.problems[0]
        device.symlink_to(path)
        until(lambda: not receiver.problems)
        os.write(ours, TEXT.encode())
        until(lambda: heard)
        device.unlink()
        os.close(theirs)
        os.close(ours)
        until(lambda: receiver.problems)
    finally:
        receiver.close()
        lines.close()


def test_without_pyserial_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name == "serial":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(LinkError, match="pip install pyserial"):
        SerialLine("/dev/ttyS0", 4800)
