"""Names of methods and results, in a file that loads no numpy: the command line reads it first."""

from __future__ import annotations

from typing import Literal

Method = Literal["smooth", "norm", "pinv", "local"]
"""What each keeps small: `twin.sense.inverse`. ``pinv`` nothing, ``local`` what ``smooth`` does,
where forces are."""

WANTED = ("displacement", "picture", "tracking", "forces", "score", "report")
"""What a run may compute: `twin.study.run`."""

CentreMethod = Literal["disc-fit", "soft-window", "two-pass"]
"""How markers' centres are measured: `twin.sense.reference.METHODS`."""

WeightRule = Literal["auto", "likelihood", "gcv"]
"""How the weight of the regularisation is chosen: `twin.sense.inverse.RULES`."""
