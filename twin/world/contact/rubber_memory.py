"""The memory of relaxing rubber under k patches.

The surface moves by u = C q, where C is the compliance at the instantaneous modulus and q are the
elastic forces: those under which rubber that doesn't relax would have the same shape. The forces
are the convolution of their changes with the relaxation function,

    f(t) = int G(t - s)/G0 dq(s) = q - sum g_i (q - H_i),    H_i = int exp(-(t - s)/tau_i) dq(s).

While q changes linearly during an interval, this is exact: f = share q + left with a number and k
vectors that are known before it. So an interval's contact is an elastic one, for the forces
f/share and the gaps of a surface that the memory alone has moved by -C left/share. A constant
contact that is held by motion has constant q, so its force relaxes exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Floats
from twin.theory.relaxation import Relaxation, fading


@dataclass(frozen=True, kw_only=True)
class RubberMemory:
    """What n terms of a Prony series remember.

    Attributes
    ----------
    relaxation
        The series.
    elastic_n
        (k, 3) q, in the patches' frames.
    kept_n
        (n, k, 3) H_i, the part of q that each term has not forgotten.
    """

    relaxation: Relaxation
    elastic_n: Floats
    kept_n: Floats

    @classmethod
    def at_rest(cls, relaxation: Relaxation, count: int) -> RubberMemory:
        """Return the memory of rubber that was never loaded."""
        kept = np.zeros((len(relaxation.share), count, 3))
        return cls(relaxation=relaxation, elastic_n=np.zeros((count, 3)), kept_n=kept)

    def over(self, seconds: float) -> tuple[float, Floats]:
        """Return ``share`` and ``left`` (k, 3), N: after an interval the forces are share q +
        left."""
        kept, mean = self._factors(seconds)
        share = self.relaxation.share
        left = np.tensordot(share * kept, self.kept_n, 1) - (share @ mean) * self.elastic_n
        return float(1.0 - share @ (1.0 - mean)), left

    def after(self, seconds: float, force_n: Floats) -> RubberMemory:
        """Return the memory after an interval at whose end the forces are (k, 3), N."""
        share, left = self.over(seconds)
        elastic = (force_n - left) / share
        kept, mean = (factor[:, None, None] for factor in self._factors(seconds))
        changed = kept * self.kept_n + mean * (elastic - self.elastic_n)
        return replace(self, elastic_n=elastic, kept_n=changed)

    def _factors(self, seconds: float) -> tuple[Floats, Floats]:
        """Return (n,) what each term keeps of an elastic force, and of one that grows linearly."""
        return fading(seconds / self.relaxation.time_s)
