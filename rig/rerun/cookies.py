"""Cookies that a browser sends: those of all programs of this host, whatever is in them."""


def cookies_of(header: str, name: str) -> list[str]:
    """The values of the cookies of this name.

    Browsers keep one set for all ports of a host. Python's own parser gives up at the first cookie that is
    not well formed, and any program of this host may have set one.
    """
    parts = (part.strip().partition("=") for part in header.split(";"))
    return [value for found, _, value in parts if found == name]
