"""Names of the ways to solve the inverse problem, in one place for recipes, the command line and `twin.sense`."""

from typing import Literal

Method = Literal["smooth", "norm", "pinv"]
"""What each keeps small is in `twin.sense.problem`; ``pinv`` nothing at all."""
