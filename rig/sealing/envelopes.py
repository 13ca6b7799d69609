"""Bytes that anybody can seal and only the owner of a key can read: X25519 and ChaCha20-Poly1305.

The public key lies with what is blind, so that a fit needs no secret to seal what it finds. The same bytes
become the same text, so that a state that is seen again is known again: the key of one use follows from
what it seals. Who knows all of the bytes already, to the last digit, can tell that he does; nobody else can.
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
_ONCE = bytes(12)
"""Each key seals one text."""
_KEY_BYTES = 32


def public_key(key: bytes) -> str:
    """What belongs to a key and seals for it, in hexadecimal."""
    return _raw(_private(_of_owner(key)))


def enclosed(data: bytes, public: str) -> str:
    """Data that only the key of this public key discloses, as text."""
    plain = zlib.compress(data)
    once = _private(hmac.digest(bytes.fromhex(public), plain, "sha256"))
    shared = once.exchange(_ciphers()[1].from_public_bytes(bytes.fromhex(public)))
    sealed = _cipher(shared, _raw(once), public).encrypt(_ONCE, plain, None)
    text = base64.b64encode(bytes.fromhex(_raw(once)) + sealed).decode()
    return f"{public[:_NAMED_CHARACTERS]}.{text}"


def disclosed(text: str, keys: Iterable[bytes]) -> bytes | None:
    """What `enclosed` was given; None where its key is none of these. Raises RecordError if it changed."""
    name, _, sealed = text.partition(".")
    key = next((key for key in keys if public_key(key).startswith(name)), None)
    if key is None:
        return None
    try:
        data = base64.b64decode(sealed, validate=True)
        once = data[:_KEY_BYTES]
        shared = _private(_of_owner(key)).exchange(_ciphers()[1].from_public_bytes(once))
        plain = _cipher(shared, once.hex(), public_key(key)).decrypt(_ONCE, data[_KEY_BYTES:], None)
        return zlib.decompress(plain)
    except Exception as error:
        # the library's own InvalidTag, or a text that is no base64
        raise RecordError(f"sealed values have changed since they were sealed ({error!r})") from None


def check_installed() -> None:
    """Raise MissingPackage where nothing can be sealed."""
    _ciphers()


def _ciphers() -> tuple[Any, Any, Any]:
    try:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
        from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
    except ImportError:
        raise MissingPackage("what is blind", "cryptography") from None
    return X25519PrivateKey, X25519PublicKey, ChaCha20Poly1305


def _of_owner(key: bytes) -> bytes:
    # apart from the offsets, which are drawn with the key itself
    return hmac.digest(key, b"sealed values", "sha256")


def _private(data: bytes) -> Any:
    return _ciphers()[0].from_private_bytes(data)


def _raw(private: Any) -> str:
    return str(private.public_key().public_bytes_raw().hex())


def _cipher(shared: bytes, once: str, public: str) -> Any:
    """Of what two keys share and both of them: HKDF by RFC 5869, of which one block is enough."""
    secret = hmac.digest(_INFO, shared, "sha256")
    return _ciphers()[2](hmac.digest(secret, bytes.fromhex(once + public) + b"\1", "sha256"))
