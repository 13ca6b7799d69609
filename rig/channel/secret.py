"""Both ends of a channel prove that they know its secret; it is never sent.

A port may have passed to another program since the file was written: who asks sends a challenge first, and
says nothing more to whoever cannot answer it. Each request then proves the secret for this connection, its
number on it and its content, so that nothing which was overheard can be used again.
"""

import hashlib
import hmac
import secrets


def challenge() -> str:
    """Something that was never asked before."""
    return secrets.token_hex(16)


def answer(secret: str, asked: str) -> str:
    """What only a session that knows the secret answers to a challenge."""
    return _proof(secret, "session", asked)


def request_proof(secret: str, connection: str, number: int, request: str, body: bytes) -> str:
    """What request `number` of a connection has to carry; `connection` is the session's own challenge."""
    return _proof(secret, "request", connection, str(number), request, hashlib.sha256(body).hexdigest())


def fits(given: str, wanted: str) -> bool:
    """Whether a proof is the one that is wanted; how far it fits takes no time that tells."""
    return hmac.compare_digest(given.encode(), wanted.encode())


def _proof(secret: str, *words: str) -> str:
    return hmac.new(secret.encode(), "\n".join(words).encode(), hashlib.sha256).hexdigest()
