"""Kernels run as Python, where compiling them takes longer than a few calls."""

from functools import wraps
from unittest import mock

import numpy as np

from testbed.core.compile import CompiledFunction


def interpreted(function):
    """Let all kernels that a function calls run as Python, with its records."""

    @wraps(function)
    def call(*args):
        with mock.patch.object(CompiledFunction, "__call__", lambda each, *own: each.py_func(*own)):
            return function(*map(_readable, args))

    return call


def _readable(array):
    """View records so that Python finds their fields as attributes."""
    is_record = isinstance(array, np.ndarray) and array.dtype.names
    return array.view(np.recarray) if is_record else array
