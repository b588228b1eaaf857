"""The door of NAOqi 2.9: TLS with a certificate of the robot's own, then a user and a token, as qi sends them."""

from __future__ import annotations

import asyncio
import hmac
import struct
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pepper_driver.backends.interface import BackendError

HEADER = struct.Struct("<IIIHBBIII")
"""Of each message of qi: magic, id, size of what follows, version, type, flags, service, object, action."""
MAGIC = 0x42ADDE42
CALL, ERROR = 1, 3
SERVER, AUTHENTICATE = 0, 8  # service and action of the first message
MAX_MESSAGE = 65536  # [B] of the first message; a real one has about 300
LOGIN_TIMEOUT = 10.0  # [s] for a client to say who it is

# Scalars of qi's signatures, and their form on the wire.
_SCALARS = {
    "b": "?", "c": "b", "C": "B", "w": "h", "W": "H", "i": "i", "I": "I", "l": "q", "L": "Q", "f": "f", "d": "d",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Login:
    """Credentials of a client. On the robot the token is the password of its user ``nao``."""

    user: str
    token: str = field(repr=False)

    async def greet(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> bytes | None:
        """Read the first message of a client; None if it is refused, with the reply of libqi."""
        try:
            async with asyncio.timeout(LOGIN_TIMEOUT):
                header = await reader.readexactly(HEADER.size)
                magic, number, size, version, kind, _, service, obj, action = HEADER.unpack(header)
                if magic != MAGIC or size > MAX_MESSAGE:
                    return None
                body = await reader.readexactly(size)
        except (TimeoutError, EOFError, OSError):
            return None
        if (kind, service, action) != (CALL, SERVER, AUTHENTICATE):
            reason = "Expected authentication"
        elif self._admits(read_capabilities(body)):
            return header + body
        else:
            reason = "Authentication failed: invalid user or token"
        text = _string("s") + _string(reason)  # a dynamic value
        writer.write(
            HEADER.pack(MAGIC, number, len(text), version, ERROR, 0, service, obj, action) + text
        )
        await writer.drain()
        return None

    def _admits(self, said: Mapping[str, object]) -> bool:
        user, token = said.get("auth_user"), said.get("auth_token")
        return (
            user == self.user
            and isinstance(token, str)
            and hmac.compare_digest(token.encode(), self.token.encode())
        )


def read_capabilities(body: bytes) -> dict[str, object]:
    """Return the scalars and texts of a map of dynamic values, ``{sm}``, up to the first value that is neither."""
    found: dict[str, object] = {}
    try:
        (count,) = struct.unpack_from("<I", body)
        at = 4
        for _ in range(count):
            key, at = _text(body, at)
            kind, at = _text(body, at)
            while kind == "m":  # a dynamic value in a dynamic value
                kind, at = _text(body, at)
            if kind == "s":
                found[key], at = _text(body, at)
            elif kind in _SCALARS:
                form = struct.Struct(f"<{_SCALARS[kind]}")
                (found[key],) = form.unpack_from(body, at)
                at += form.size
            else:
                break
    except (struct.error, UnicodeDecodeError):
        pass  # truncated, or no map: the client is refused
    return found


def _text(body: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    end = at + 4 + size
    if end > len(body):
        raise struct.error("text beyond the end")
    return body[at + 4 : end].decode(), end


def _string(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def make_certificate(folder: str) -> tuple[Path, Path]:
    """Files of a self-signed certificate and of its key, made now by the program ``openssl``.

    Raises:
        BackendError: There is no such program, or it fails.
    """
    certificate, key = Path(folder) / "certificate.pem", Path(folder) / "key.pem"
    command = [
        *("openssl", "req", "-x509", "-nodes", "-days", "30", "-subj", "/CN=pepper-stand-in"),
        *("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
        *("-keyout", str(key), "-out", str(certificate)),
    ]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except FileNotFoundError:
        raise BackendError(
            "a server with TLS needs the program 'openssl' for its certificate: install openssl"
        ) from None
    except subprocess.CalledProcessError as error:
        raise BackendError(f"openssl made no certificate: {error.stderr.strip()}") from error
    return certificate, key
