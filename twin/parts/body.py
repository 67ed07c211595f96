"""Every kind of body there is; a scene's ``body.shape`` picks one."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from twin.parts.block import Block
from twin.parts.dome import Dome
from twin.parts.finger import Finger
from twin.parts.shape import Body
from twin.parts.solid import Solid

__all__ = ["AnyBody", "Block", "Body", "Dome", "Finger", "Solid"]

AnyBody = Annotated[Block | Dome | Finger | Solid, Field(discriminator="shape")]
