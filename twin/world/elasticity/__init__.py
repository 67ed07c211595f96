"""How a body moves under given forces: the compliance, and all that it is made of."""
