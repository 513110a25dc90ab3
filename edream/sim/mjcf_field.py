"""Any scalar field of an MJCF as an unknown, by its name: `body.mass`, `geom.friction`, `joint.stiffness`."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.errors import EdreamError, unknown_name
from edream.core.parameters import Parameter
from edream.sim.robot import RobotModel

# word in the config -> field of mujoco.MjModel, addressed by the element's own number or by the joint's first degree of freedom
ELEMENTS = {"body": "body", "geom": "geom", "joint": "joint", "actuator": "actuator"}
DOF_FIELDS = {"damping", "armature", "frictionloss"}
PREFIX = {"body": "body_", "geom": "geom_", "joint": "jnt_", "actuator": "actuator_"}


class MjcfField(Effect):
    """A number of the model that is not known well enough.

    Searched by its ratio to the published number, from a tenth to ten times; a field that is 0 needs `fit.limits`. Of a field with
    several components, such as friction, the first is meant.
    """

    summary = "another value of a model field"
    confusable = ()

    def __init__(self, element: str, field: str) -> None:
        self.name, self.field = element, field
        self.place = "geom" if element == "geom" else "body"
        self.column = f"dof_{field}" if element == "joint" and field in DOF_FIELDS else PREFIX[element] + field

    @classmethod
    def of(cls, robot: RobotModel, name: str, targets: Sequence[str]) -> "MjcfField":
        """The field that a config names.

        Args:
            name: `element.field`, such as `body.mass`.
            targets: names of the elements it is meant on.

        Raises:
            EdreamError: there is no such element or field, or it is no number that a simulation may vary.
        """
        element, _, field = name.partition(".")
        if element not in ELEMENTS:
            raise unknown_name("kind of model element", element, ELEMENTS)
        made = cls(element, field)
        model = robot.model
        known = [n.removeprefix(PREFIX[element]) for n in dir(model) if n.startswith(PREFIX[element])]
        known = [n for n in known if getattr(getattr(model, PREFIX[element] + n), "dtype", None) == np.float64]
        if not hasattr(model, made.column) or getattr(model, made.column).dtype != np.float64:
            raise unknown_name(f"number of a {element}", field, {*known, *(DOF_FIELDS if element == "joint" else ())})
        if not targets:
            raise EdreamError(f"Field {name!r} needs a place: {name}@NAME of a {element}.")
        elements = [
            getattr(model, element)(i).name
            for i in range(getattr(model, {"joint": "njnt", "actuator": "nu"}.get(element, f"n{element}")))
        ]
        for target in targets:
            if target not in elements:
                raise unknown_name(element, target, [one for one in elements if one])
        return made

    def row(self, model: mujoco.MjModel, target: str) -> int:
        number = int(getattr(model, self.name)(target).id)
        return int(model.jnt_dofadr[number]) if self.column.startswith("dof_") else number

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        nominal = float(np.ravel(getattr(model, self.column)[self.row(model, targets[0])])[0])
        if nominal > 0.0:
            return (Parameter(self.field, "SI", nominal / 10.0, nominal * 10.0, nominal, scale="log"),)
        reach = 10.0 * abs(nominal) or 1.0
        return (Parameter(self.field, "SI", -reach if nominal else 0.0, reach, nominal),)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        row = self.row(fields.model, target)
        column = fields[self.column]
        if self.column == "body_mass":
            # A heavier body of the same shape turns harder too.
            fields["body_inertia"][:, row] = (
                fields.model.body_inertia[row] * (values[self.field] / fields.model.body_mass[row])[:, None]
            )
        if column.ndim == 2:
            column[:, row] = values[self.field]
        else:
            column[:, row, 0] = values[self.field]
