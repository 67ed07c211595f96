"""Materials of the tests of finite strain, and the closed form of their stretch."""

import pytest

from twin.parts.material import Material

LAWS = [
    Material(law="neo_hookean"),
    Material(law="neo_hookean", poisson_ratio=0.47),
    Material(law="mooney_rivlin", law_ratios=(0.6,)),
    Material(law="yeoh", law_ratios=(0.3, 0.1)),
]
every_law = pytest.mark.parametrize("material", LAWS, ids=lambda one: f"{one.law}-{one.poisson_ratio}")


def nominal_stress(material, stretch):
    """Return 2 (l - l^-2) (W1 + W2 / l) of incompressible rubber of E = 1 MPa whose sides are free."""
    ratios = material.law_ratios
    more = stretch**2 + 2.0 / stretch - 3.0
    first, second = 0.5, 0.0
    if material.law == "mooney_rivlin":
        first, second = 0.5 / (1.0 + ratios[0]), 0.5 * ratios[0] / (1.0 + ratios[0])
    if material.law == "yeoh":
        first = 0.5 * (1.0 + 2.0 * ratios[0] * more + 3.0 * ratios[1] * more**2)
    return 2.0 / 3.0 * (stretch - stretch**-2) * (first + second / stretch)
