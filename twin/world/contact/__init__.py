"""How rigid probes press: tractions that only push, friction with a history."""
