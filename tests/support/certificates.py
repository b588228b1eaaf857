"""Certificates for servers with TLS."""

from __future__ import annotations

import subprocess
from pathlib import Path


def certificate_in(folder: Path) -> tuple[Path, Path]:
    """Make a self-signed certificate and its key by the program ``openssl``; return their files."""
    files = folder / "certificate.pem", folder / "key.pem"
    subprocess.run(
        [*["openssl", "req", "-x509", "-nodes", "-days", "2", "-subj", "/CN=fake", "-newkey", "ec"],
         "-pkeyopt", "ec_paramgen_curve:prime256v1", "-keyout", files[1], "-out", files[0]],
        check=True, capture_output=True,
    )  # fmt: skip
    return files
