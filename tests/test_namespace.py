import array_api_compat.torch
import numpy as np
import pytest
import torch

from mjris.radio.namespace import array_namespace


def test_each_array_has_its_library():
    for _ in range(2):  # known the second time
        assert array_namespace(np.ones(2), np.zeros(3)) is np
        assert array_namespace(torch.ones(2)) is array_api_compat.torch
        assert array_namespace(torch.ones(2), 1.0) is array_api_compat.torch


def test_libraries_do_not_mix():
    array_namespace(np.ones(2))
    with pytest.raises(TypeError, match=r"[Mm]ultiple"):
        array_namespace(np.ones(2), torch.ones(2))
