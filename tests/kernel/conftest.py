"""One boot of a guest for all tests of a file.

Run by ``make test-kernel``; skipped, with the reason, where QEMU or a kernel can't be had.
"""

from typing import Any

import pytest

from tests.kernel.boot import Missing, find_kernel, module_files, run_in_guest

TIME_LIMIT_S = 1000.0


@pytest.fixture(scope="module")
def results(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What happened in the guest that the file names as GUEST; it is asserted outside."""
    try:
        vivid = module_files(find_kernel()[1], ["vivid"])[-1]
        program = f"tests.kernel.{request.module.GUEST}".format(vivid=vivid)
        return run_in_guest(program, tmp_path_factory.mktemp("guest"), TIME_LIMIT_S)
    except Missing as missing:
        pytest.skip(str(missing))
