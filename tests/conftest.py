"""What the tests share. Warp keeps its kernel cache between runs, so only the first run waits for the compiler."""

import pytest
import warp as wp

wp.config.log_level = wp.LOG_WARNING  # no banner, no line for each module loaded


@pytest.fixture(scope="session", params=["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request):
    """Name of a device: the CPU, and under the marker gpu a CUDA device."""
    if request.param == "cuda" and not wp.is_cuda_available():
        pytest.skip("there is no CUDA device")
    return request.param
