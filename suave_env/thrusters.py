"""The six thrusters: the mixer that shares a wanted force among them, their limit, and their failure."""

import math

from suave_env.settings import Settings

COUNT = 6
"""Number of thrusters: 1 front right, 2 front left, 3 rear right, 4 rear left, 5 right and 6 left vertical."""

_COSINE = 0.7071067811865476
_YAW_ARM_M = 0.1676  # mean of the arms of the front pair (0.164 m) and the rear pair (0.171 m)
_ROLL_ARM_M = 0.109
_DENSITY_KG_M3 = 1000.0  # of the water, as the buoyancy of SUAVE's world has it


class Thrusters:
    """Shares a wanted force among the thrusters; the mixer knows nothing of failures.

    A failed thruster is frozen at its last output: with its servo function set to 0, ArduPilot stops writing the
    channel, and the simulated motor keeps pushing (kas-lab/suave v1.3.0).

    Attributes:
        outputs: Thrusts [N] of thrusters 1 to 6, positive along the direction of each in the model.
        energy_j: Energy that they have put into the water [J], with ideal propellers.
    """

    def __init__(self, settings: Settings) -> None:
        self.outputs = [0.0] * COUNT
        self.energy_j = 0.0
        # an actuator disc of area A takes |T|^1.5 / sqrt(2 rho A) to push still water of density rho
        self._power = 1 / math.sqrt(2 * _DENSITY_KG_M3 * math.pi / 4 * settings.propeller_m**2)
        self._limit = settings.thrust_limit_n
        self._stuck: dict[int, float] = {}

    @property
    def failed(self) -> tuple[int, ...]:
        return tuple(sorted(self._stuck))

    def fail(self, number: int) -> None:
        """Freeze a thruster, 1 to 6, at its last output."""
        self._stuck.setdefault(number, self.outputs[number - 1])

    def recover(self, number: int) -> None:
        """Restore a thruster, 1 to 6: it obeys again."""
        self._stuck.pop(number, None)

    def allocate(
        self, forward: float, left: float, up: float, roll: float, turn: float, duration: float = 0.0
    ) -> list[float]:
        """Share a wanted force and torque among the thrusters, count the energy of a duration [s], return the outputs.

        The shares are those of the "vectored" frame of ArduPilot's Sub, for thrusts along the directions of the model.
        Forces along x, y and z of the body frame [N]; torques about its x and z [N m], a turn positive to the left.

        Returns:
            The six outputs [N]. Beyond the limit, the thrusts of a group are scaled together: the direction stays.
        """
        forward, left, turn = forward / (4 * _COSINE), left / (4 * _COSINE), turn / (4 * _YAW_ARM_M)
        one, two = -forward - left - turn, -forward + left + turn
        three, four = forward - left + turn, forward + left - turn
        five, six = roll / (2 * _ROLL_ARM_M) - up / 2, -roll / (2 * _ROLL_ARM_M) - up / 2
        limit = self._limit
        level = max(abs(one), abs(two), abs(three), abs(four))
        if level > limit:
            scale = limit / level
            one, two, three, four = one * scale, two * scale, three * scale, four * scale
        upright = max(abs(five), abs(six))
        if upright > limit:
            five, six = five * limit / upright, six * limit / upright
        self.outputs = outputs = [one, two, three, four, five, six]
        if self._stuck:
            for number, frozen in self._stuck.items():
                outputs[number - 1] = frozen
            one, two, three, four, five, six = outputs
        thrusts = abs(one) ** 1.5 + abs(two) ** 1.5 + abs(three) ** 1.5 + abs(four) ** 1.5
        self.energy_j += (thrusts + abs(five) ** 1.5 + abs(six) ** 1.5) * self._power * duration
        return outputs
