"""Bytes that anybody can seal and only the owner of a key can read: HPKE, RFC 9180, by `cryptography`.

The public key lies with what is blind, so that a fit needs no secret to seal what it finds.
"""

import base64
import hmac
import zlib
from collections.abc import Iterable
from typing import Any

from processing.errors import MissingPackage, RecordError

_INFO = b"optical-pendulum-rig sealed values 1"
_NAMED_CHARACTERS = 16
"""Of a public key before what it sealed, by which the key to read it is found."""


def public_key(key: bytes) -> str:
    """What belongs to a key and seals for it, in hexadecimal."""
    return bytes(_private(key).public_key().public_bytes_raw()).hex()


def enclosed(data: bytes, public: str) -> str:
    """Data that only the key of this public key discloses, as text; each time another one."""
    try:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey
    except ImportError:
        raise _missing() from None
    owner = X25519PublicKey.from_public_bytes(bytes.fromhex(public))
    sealed = _suite().encrypt(zlib.compress(data), owner, info=_INFO)
    return f"{public[:_NAMED_CHARACTERS]}.{base64.b64encode(sealed).decode()}"


def disclosed(text: str, keys: Iterable[bytes]) -> bytes | None:
    """What `enclosed` was given; None where its key is none of these. Raises RecordError if it changed."""
    name, _, sealed = text.partition(".")
    key = next((key for key in keys if public_key(key).startswith(name)), None)
    if key is None:
        return None
    try:
        plain = _suite().decrypt(base64.b64decode(sealed, validate=True), _private(key), info=_INFO)
        return zlib.decompress(plain)
    except Exception as error:
        # the library's own InvalidTag, or a text that is no base64
        raise RecordError(f"sealed values have changed since they were sealed ({error!r})") from None


def check_installed() -> None:
    """Raise MissingPackage where nothing can be sealed."""
    _suite()


def _suite() -> Any:
    try:
        from cryptography.hazmat.primitives import hpke
    except ImportError:
        raise _missing() from None
    return hpke.Suite(hpke.KEM.X25519, hpke.KDF.HKDF_SHA256, hpke.AEAD.CHACHA20_POLY1305)


def _private(key: bytes) -> Any:
    try:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
    except ImportError:
        raise _missing() from None
    # apart from the offsets, which are drawn with the key itself
    return X25519PrivateKey.from_private_bytes(hmac.digest(key, b"sealed values", "sha256"))


def _missing() -> MissingPackage:
    return MissingPackage("what is blind", "cryptography")
