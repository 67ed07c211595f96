"""A sheared push starts near its end."""

from presses import ball, pressed, pushed

from twin.world.contact import load_step


def test_a_sheared_push_takes_few_newton_steps(monkeypatch):
    """From a push without friction, with the shear of Cattaneo and Mindlin: 5; without it 7."""
    steps, real = [], load_step.solve_coulomb

    def counting(*arguments):
        found = real(*arguments)
        steps.append(found.steps)
        return found

    monkeypatch.setattr(load_step, "solve_coulomb", counting)
    pressed(ball(30, friction=0.4, steps=(pushed(0.12),)), across=12, increments=1)
    assert steps[0] <= 5
