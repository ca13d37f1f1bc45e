"""Arrays that are nearly equal: `pytest.approx` takes 10 µs for each of their numbers."""

import numpy as np


def assert_close(found, expected, within):
    """Every number is within an absolute distance of the expected one."""
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=within, equal_nan=False)
