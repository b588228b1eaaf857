"""Who is there, before and after ``qi`` fails to connect, which does not say why."""

from __future__ import annotations

import socket
import ssl
from typing import Literal

from pepper_driver.backends.interface import NotConnectedError
from pepper_driver.backends.naoqi.address import PORTS, USER, Address

PROBE_TIME = 2.0
"""[s] a peer may take to begin with TLS. A robot in the same building takes a tenth of it."""


class NoAnswerError(NotConnectedError, TimeoutError):
    """Somebody listens, but says nothing."""


class LoginError(NotConnectedError, PermissionError):
    """The robot does not let this user in."""


def check_listening(address: Address, timeout: float) -> None:
    """Raise a NotConnectedError that says why, where nobody listens at ``address`` within ``timeout`` [s]."""
    try:
        socket.create_connection((address.host, address.port), timeout=timeout).close()
    except socket.gaierror as error:
        raise NotConnectedError(
            f"'{address.uri}': no computer is called '{address.host}'; press the robot's chest button once and use "
            "the address it says"
        ) from error
    except ConnectionRefusedError as error:
        raise NotConnectedError(
            f"'{address.uri}': {address.host} is there, but nobody listens at port {address.port}; NAOqi 2.5 listens "
            f"at {PORTS['naoqi']} (naoqi://), 2.9 at {PORTS['naoqis']} (naoqis://), minutes after its start"
        ) from error
    except (OSError, UnicodeError) as error:
        raise NotConnectedError(
            f"'{address.uri}': {address.host} does not answer; is the robot on, and in the same network? Its chest "
            "button, pressed once, tells its address"
        ) from error


def refusal(address: Address, *, silent: bool) -> NotConnectedError:
    """Why ``qi`` did not get in where somebody listens.

    Args:
        address: Where.
        silent: Whether it still waited for an answer, and was not turned away.
    """
    peer = _peer(address)
    place = f"{address.host}:{address.port}"
    if peer == "tls" and not address.secure:
        return NotConnectedError(
            f"'{address.uri}': {place} speaks TLS, as NAOqi 2.9 does; write naoqis://{USER}@{place}"
        )
    if peer == "plain" and address.secure:
        return NotConnectedError(
            f"'{address.uri}': {place} speaks no TLS; NAOqi 2.5 has none: write naoqi://{address.host}"
        )
    if silent or peer == "silent":
        return NoAnswerError(
            f"'{address.uri}': {place} takes connections and says nothing; NAOqi hangs or is starting: wait for the "
            "robot's voice, or restart it"
        )
    if address.secure:
        return LoginError(
            f"'{address.uri}': {place} does not let '{address.user}' in; wrong password, or no robot. The password is "
            "that of the robot's web page"
        )
    return NotConnectedError(
        f"'{address.uri}': what listens at {place} is no NAOqi; is it the robot's address and port?"
    )


def _peer(address: Address) -> Literal["tls", "plain", "silent"]:
    """What whoever listens makes of the begin of TLS. Nothing is said in it, and no certificate is believed."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        with (
            socket.create_connection((address.host, address.port), timeout=PROBE_TIME) as plain,
            context.wrap_socket(plain),
        ):
            return "tls"
    except TimeoutError:
        return "silent"
    except OSError:  # ssl.SSLError is one
        return "plain"
