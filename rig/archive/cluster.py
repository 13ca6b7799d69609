"""A Dask cluster that runs already."""

from typing import Any

from processing.errors import ConfigurationError, MissingPackage


def client_of(address: str) -> Any:
    """A client of its scheduler, to be closed.

    Raises
    ------
    MissingPackage
        Dask is not installed.
    ConfigurationError
        No scheduler answers there.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingPackage("--cluster", "distributed") from None
    try:
        return Client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise ConfigurationError(f"--cluster {address}: no Dask scheduler answers there: {error}") from None
