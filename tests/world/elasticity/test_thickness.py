"""Blocks between blocks: an interpolated table equals a solve on the block's own mesh."""

from __future__ import annotations

import numpy as np
import pytest

from twin.parts.body import Block
from twin.parts.load import Traction
from twin.parts.material import Material
from twin.world.elasticity.compliance import Compliance
from twin.world.elasticity.solve import factorisations
from twin.world.elasticity.thickness import GOOD, table_between
from twin.world.elasticity.tile import tile

LOADS = (
    Traction.rectangle((0, 0), (4, 4), (1, 0, 0)),
    Traction.rectangle((5, -4), (2, 2), (0, 0, 1)),
    Traction.rectangle((-9, 7), (3, 3), (0, 1, 0.5)),
)


def block(thickness_mm: float) -> Block:
    return Block(width_mm=100, length_mm=90, thickness_mm=thickness_mm)


def test_there_is_none_outside_its_range_or_over_too_wide_a_range() -> None:
    assert table_between(block(29.0), "nominal", 30.0, 50.0) is None
    assert table_between(block(40.0), "nominal", 10.0, 50.0) is None


@pytest.mark.slow
def test_an_interpolated_block_is_a_solved_one_and_factors_nothing() -> None:
    points = np.random.default_rng(1).uniform([-20, -17, 0.3], [20, 17, 6.5], (200, 3))
    table_between(block(40.3), "nominal", 30.0, 50.0)
    for thickness, nu in ((30.0, 0.5), (40.3, 0.45), (50.0, 0.5)):
        body, material = block(thickness), Material(youngs_modulus_mpa=1.0, poisson_ratio=nu)
        table = table_between(body, "nominal", 30.0, 50.0)
        assert table is not None
        before = factorisations()
        got = [
            Compliance(body, material, level="nominal", table=table).displacement(points, tile(load, body))
            for load in LOADS
        ]
        assert factorisations() == before
        solved = Compliance(body, material, level="nominal", table=False)
        for load, moved in zip(LOADS, got, strict=True):
            wanted = solved.displacement(points, tile(load, body))
            assert np.linalg.norm(moved - wanted, axis=1).max() < GOOD * np.linalg.norm(wanted, axis=1).max()
        thinner = table_between(block(31.0), "nominal", 30.0, 50.0)
        assert thinner is not None
        if thickness == 50.0:  # 50 mm are told from 31: the test above could fail
            wrong = Compliance(body, material, level="nominal", table=thinner)
            moved = wrong.displacement(points, tile(LOADS[0], body))
            wanted = solved.displacement(points, tile(LOADS[0], body))
            assert np.linalg.norm(moved - wanted, axis=1).max() > 10 * GOOD * np.linalg.norm(wanted, axis=1).max()
