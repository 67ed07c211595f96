"""Names of the ways to solve the inverse problem, in one place for recipes, the command line and `twin.sense`."""

from typing import Literal

Method = Literal["smooth", "norm", "pinv", "local"]
"""What each keeps small: `twin.sense.problem`. ``pinv`` nothing, ``local`` what ``smooth`` does, where forces are."""
