"""Hidden effects of masses, springs and shafts."""

from dataclasses import replace

import numpy as np

from edream.reality.plant import Moment, Plant, Term


class Armature(Term):
    """Rotor inertia that the model does not have, `inertia` [kg m^2]."""

    def plant(self, plant: Plant) -> Plant:
        return plant.with_values(armature=plant.armature + self.of("inertia"))


class Payload(Term):
    """A point mass `mass` [kg] fixed to a body at `x`, `y`, `z` [m] in its frame; the body's number is `other`."""

    def plant(self, plant: Plant) -> Plant:
        centre = np.array([self.values[axis] for axis in "xyz"])
        return replace(plant, tree=plant.tree.with_mass(self.other, self.values["mass"], centre))


class GravityTilt(Term):
    """The base stands crooked: turned by `roll` [rad] about the world's x, then by `pitch` [rad] about its y."""

    def plant(self, plant: Plant) -> Plant:
        (sr, cr), (sp, cp) = ((np.sin(self.values[n]), np.cos(self.values[n])) for n in ("roll", "pitch"))
        roll = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        pitch = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        return plant.with_values(gravity=(pitch @ roll).T @ plant.gravity)


class ConstantTorque(Term):
    """A torque that is always there, `torque` [N m]."""

    def passive(self, now: Moment) -> np.ndarray:
        return self.of("torque")


class ParallelSpring(Term):
    """A spring across the joint: `stiffness` [N m/rad] and, hardening, `cubic` [N m/rad^3], at rest at `rest` [rad]."""

    link_side = True

    def passive(self, now: Moment) -> np.ndarray:
        stretch = now.q - self.values["rest"]
        return -self.of("stiffness") * stretch - self.of("cubic") * stretch**3


class Cogging(Term):
    """Magnets in the motor: `torque` [N m] times sin(`count` theta + `phase` [rad])."""

    def passive(self, now: Moment) -> np.ndarray:
        return self.of("torque") * np.sin(self.values["count"] * now.theta + self.values["phase"])


class JointCompliance(Term):
    """A shaft that gives between motor and link: `compliance` [rad/(N m)]; the encoder sits on the link."""

    def plant(self, plant: Plant) -> Plant:
        if self.values["compliance"] == 0.0:
            return plant
        stiffness = 1.0 / self.values["compliance"]
        damping = 0.1 * np.sqrt(stiffness * plant.armature)
        on = self.on > 0
        return plant.with_values(give=np.where(on, stiffness, plant.give), give_damping=np.where(on, damping, plant.give_damping))


class Backlash(Term):
    """Play between motor and link: the link is free over `width` [rad] in all; the encoder sits on the link."""

    def plant(self, plant: Plant) -> Plant:
        if self.values["width"] == 0.0:
            return plant
        on = self.on > 0
        # Teeth are some forty times stiffer than the servo: they count as hard, and the impact stays resolved.
        give = np.where(on & np.isinf(plant.give), 40.0 * plant.kp, plant.give)
        damping = np.where(
            on,
            np.maximum(np.sqrt(give * plant.armature, where=on, out=np.zeros_like(give)), plant.give_damping),
            plant.give_damping,
        )
        return plant.with_values(give=give, give_damping=damping, gap=np.where(on, 0.5 * self.values["width"], plant.gap))


class JointCoupling(Term):
    """Position and speed of another joint pull on this one: `stiffness` [N m/rad] and `damping` [N m s/rad]."""

    link_side = True

    def passive(self, now: Moment) -> np.ndarray:
        return self.of("stiffness") * now.q[:, self.other, None] + self.of("damping") * now.v[:, self.other, None]
