"""Where sentences go and come from: UDP (unicast, broadcast, multicast) and serial lines.

Lives here: `parse_link`, `resolve`, `Sender`, `Receiver` (a thread that waits for all inputs at once), `SerialLine`.
Does not live here: what the bytes mean (sentences.py, aids.py). A line that breaks is opened again every two seconds; pyserial is needed for
serial lines alone.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

from riins_core.settings import SettingError

BAUDS = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
_RETRY_S = 2.0
_WAKE_S = 0.2
_BACKLOG = 1024
"""Bytes a slow serial line may be behind; then whole sentences are left out and counted."""


class LinkError(RuntimeError):
    """A link cannot be opened; one line."""


@dataclass(frozen=True)
class Link:
    """An address: `host` and `port` of UDP with the `interface` and `ttl` of a multicast, or `device` and `baud` of a serial line."""

    text: str
    host: str = ""
    port: int = 0
    interface: str = "0.0.0.0"
    ttl: int = 1
    device: str = ""
    baud: int = 0

    @property
    def multicast(self) -> bool:
        """The host is a multicast group."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_multicast
        return False


def parse_link(text: str, output: bool) -> Link:
    """Read an address.

    Parameters
    ----------
    text : udp://HOST:PORT[?interface=ADDRESS&ttl=N] or serial:///DEVICE[?baud=N], 4800 unless said
    output : sentences go there

    Returns
    -------
    Link

    Raises
    ------
    SettingError
        One line with what is wrong.
    """
    wanted = "udp://HOST:PORT or serial:///dev/NAME?baud=N"
    try:
        parts = urlsplit(text)
        options = {name: values[-1] for name, values in parse_qs(parts.query, keep_blank_values=True, strict_parsing=bool(parts.query)).items()}
        host, port = parts.hostname or "", parts.port
    except ValueError as error:
        raise SettingError(f"{text!r} is no address ({error}); {wanted} is wanted") from None
    if parts.scheme == "serial":
        baud = options.pop("baud", "4800")
        if not parts.path.strip("/") or parts.netloc or options:
            raise SettingError(f"{text!r} is no serial line; serial:///dev/NAME?baud=N is wanted")
        if not baud.isdigit() or int(baud) not in BAUDS:
            raise SettingError(f"{text!r}: the baud rate must be one of {', '.join(map(str, BAUDS))}")
        return Link(text, device=parts.path, baud=int(baud))
    if parts.scheme != "udp" or not host or not port or parts.path.strip("/"):
        raise SettingError(f"{text!r} is no address; {wanted} is wanted")
    interface, ttl = options.pop("interface", "0.0.0.0"), options.pop("ttl", "1")
    if options or not ttl.isdigit() or not 0 <= int(ttl) <= 255:
        raise SettingError(f"{text!r}: udp has the options interface=ADDRESS and ttl=0..255")
    try:
        ipaddress.IPv4Address(interface)
        if not output:
            ipaddress.IPv4Address(host)
    except ValueError:
        raise SettingError(f"{text!r}: IPv4 addresses are wanted; 0.0.0.0 listens on every interface") from None
    return Link(text, host, port, interface, int(ttl))


def resolve(link: Link) -> str:
    """IP address of the host of a UDP link.

    Raises
    ------
    LinkError
        The host is not known.
    """
    try:
        return socket.gethostbyname(link.host)
    except (OSError, UnicodeError):  # the codec of host names refuses an empty label or one that is too long
        raise LinkError(f"{link.text}: the host {link.host!r} is not known") from None


class SerialLine:
    """A serial device for both directions, opened again when it breaks.

    Raises
    ------
    LinkError
        pyserial is missing.
    """

    def __init__(self, device: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise LinkError("a serial line needs pyserial: pip install pyserial, or apt install python3-serial") from None
        self._serial, self.device, self.baud = serial, device, baud
        self._port: Any = None
        self._next = 0.0
        self._lock = threading.Lock()
        self._backlog = b""
        self.problem = ""

    def port(self) -> Any:
        """The open port, or None while it cannot be opened."""
        with self._lock:
            if self._port is None and time.monotonic() >= self._next:
                self._next = time.monotonic() + _RETRY_S
                try:
                    self._port = self._serial.Serial(self.device, self.baud, timeout=0, write_timeout=0)
                    self.problem, self._backlog = "", b""
                except (OSError, ValueError) as error:
                    self.problem = f"{self.device} cannot be opened: {_reason(error)}"
            return self._port

    def broken(self, error: Exception) -> None:
        """Close after an error."""
        with self._lock:
            self.problem = f"{self.device}: {_reason(error)}"
            if self._port is not None:
                with contextlib.suppress(OSError):
                    self._port.close()
            self._port, self._next = None, time.monotonic() + _RETRY_S

    def write(self, data: bytes) -> bool:
        """Write without waiting; False when the line is closed or so far behind that `data` was left out."""
        port = self.port()
        if port is None:
            return False
        fits = len(self._backlog) + len(data) <= _BACKLOG
        self._backlog += data if fits else b""
        try:
            # os.write takes what there is room for; what is left waits for the next sentence
            self._backlog = self._backlog[os.write(port.fileno(), self._backlog) :]
        except BlockingIOError:
            pass
        except OSError as error:
            self.broken(error)
            return False
        return fits

    def close(self) -> None:
        """Close for good."""
        with self._lock:
            if self._port is not None:
                with contextlib.suppress(OSError):
                    self._port.close()
            self._port, self._next = None, float("inf")


class SerialLines:
    """The serial lines of a node by device: one that is input and output is opened once."""

    def __init__(self) -> None:
        self._lines: dict[str, SerialLine] = {}

    def line(self, link: Link) -> SerialLine:
        """The line of a link.

        Raises
        ------
        LinkError
            The same device at two baud rates, or no pyserial.
        """
        if link.device not in self._lines:
            self._lines[link.device] = SerialLine(link.device, link.baud)
        line = self._lines[link.device]
        if line.baud != link.baud:
            raise LinkError(f"{link.device} is named with {line.baud} and with {link.baud} baud")
        return line

    def close(self) -> None:
        """Close all."""
        for line in self._lines.values():
            line.close()


class Sender:
    """One output; `sent` and `failed` count sentences.

    Raises
    ------
    LinkError
        The host is not known, or pyserial is missing.
    """

    def __init__(self, link: Link, lines: SerialLines) -> None:
        self.link = link
        self.sent = self.failed = 0
        self._problem = ""
        self._line = lines.line(link) if link.device else None
        self._socket: socket.socket | None = None
        if self._line is None:
            self._address = (resolve(link), link.port)  # once: a name server must not hold up every sentence
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            if link.multicast:
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, link.ttl)
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(link.interface))

    @property
    def problem(self) -> str:
        """The last thing that went wrong, '' when the last sentence went out."""
        return self._problem or (self._line.problem if self._line is not None else "")

    def send(self, sentences: Iterable[str]) -> None:
        """Send each sentence, one a datagram; never waits, never raises."""
        for text in sentences:
            if self._write(text.encode("ascii")):
                self.sent += 1
                self._problem = ""
            else:
                self.failed += 1

    def _write(self, data: bytes) -> bool:
        if self._line is not None:
            good = self._line.write(data)
            self._problem = "" if good or self._line.problem else f"{self._line.device} at {self._line.baud} baud is too slow for these rates"
            return good
        assert self._socket is not None
        try:
            self._socket.sendto(data, self._address)
        except OSError as error:
            self._problem = f"{self.link.text}: {_reason(error)}"
            return False
        return True

    def close(self) -> None:
        """Close the socket; serial lines are closed by SerialLines."""
        if self._socket is not None:
            self._socket.close()


class Receiver:
    """A thread that waits for bytes on all inputs.

    Parameters
    ----------
    links : inputs
    lines : the node's serial lines
    take : called in the thread with (name of the input, bytes, whether a datagram ends here)

    Raises
    ------
    LinkError
        A UDP port cannot be bound.
    """

    def __init__(self, links: Iterable[Link], lines: SerialLines, take: Callable[[str, bytes, bool], None]) -> None:
        self._take = take
        self._sockets: dict[int, tuple[str, socket.socket]] = {}
        self._lines: list[tuple[str, SerialLine]] = []
        self._ending = threading.Event()
        try:
            for link in links:
                if link.device:
                    self._lines.append((link.text, lines.line(link)))
                else:
                    one = _listen(link)
                    self._sockets[one.fileno()] = (link.text, one)
        except LinkError:
            self._close()
            raise
        self._thread = threading.Thread(target=self._run, name="nmea_in", daemon=True)
        self._thread.start()

    @property
    def problems(self) -> list[str]:
        """What is wrong with serial inputs, one line each."""
        return [line.problem for _, line in self._lines if line.problem]

    def close(self) -> None:
        """End the thread, then close the sockets."""
        self._ending.set()
        self._thread.join(5.0)
        self._close()

    def _close(self) -> None:
        for _, one in self._sockets.values():
            one.close()

    def _run(self) -> None:
        while not self._ending.is_set():
            ports = {port.fileno(): (name, line, port) for name, line in self._lines if (port := line.port()) is not None}
            try:
                readable, _, _ = select.select([*self._sockets, *ports], [], [], _WAKE_S)
            except (OSError, ValueError):  # a port was closed by the writing side meanwhile
                continue
            if not self._sockets and not ports:
                self._ending.wait(_WAKE_S)
            for number in readable:
                if number in self._sockets:
                    name, one = self._sockets[number]
                    with contextlib.suppress(OSError):
                        self._take(name, one.recv(65536), True)
                else:
                    name, line, port = ports[number]
                    try:
                        data = os.read(port.fileno(), 4096)
                        if not data:
                            raise OSError("the device was unplugged")
                        self._take(name, data, False)
                    except (OSError, ValueError, TypeError) as error:
                        line.broken(error)


def _listen(link: Link) -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if link.multicast:  # any number may hear a group; of two that share another port, one would hear nothing
            one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            one.bind((link.host, link.port))  # to the group: datagrams for others on this port are not ours
            one.setsockopt(
                socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, struct.pack("4s4s", socket.inet_aton(link.host), socket.inet_aton(link.interface))
            )
        else:
            one.bind((link.host, link.port))
        one.setblocking(False)
    except OSError as error:
        one.close()
        taken = "another program, or another nmea node, listens there" if error.errno == errno.EADDRINUSE else _reason(error)
        raise LinkError(f"{link.text} cannot be listened to: {taken}") from None
    return one


def _reason(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())
