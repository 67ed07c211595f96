"""Distributions of a recipe's numbers."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from twin.parts.vary import CUT, Normal


@pytest.mark.parametrize("u", [0.0, 0.2, 0.5, 1.0])
def test_a_normal_number_grows_with_its_draw_and_is_cut_where_a_maker_rejects(u: float) -> None:
    wanted = truncnorm.ppf(u, -CUT, CUT, loc=3.0, scale=0.1)
    assert Normal(mean=3.0, sd=0.1).at(np.array([u])) == pytest.approx(wanted, rel=1e-9)
