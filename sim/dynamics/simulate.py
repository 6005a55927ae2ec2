"""The forward simulation: steps person, soles, couplings and controller together, and returns the simulated walk.

The controller does not know the disturbances: true body mass and floor height, pushes, joint noise and missteps.
"""

from __future__ import annotations

import copy
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from stridetwin.sim.config import SIDES, Dynamics, Exo
from stridetwin.sim.dynamics.contacts import Contacts, sense_floor, sole_point_numbers, subtract_bias
from stridetwin.sim.dynamics.controller import Controller, Gains
from stridetwin.sim.dynamics.couplings import CouplingSet, coupling_forces
from stridetwin.sim.dynamics.drive import DRIVER_S, ControlLaw, Drive
from stridetwin.sim.dynamics.footstep_replanning import StepReplan, advance_shifts
from stridetwin.sim.dynamics.plan import CONTROL_S, Plan
from stridetwin.sim.dynamics.simulated_walk import FootRecord, SimulatedWalk
from stridetwin.sim.dynamics.soles import PER_FOOT, TOE_DAMPING
from stridetwin.sim.dynamics.spatial import State, chain_of
from stridetwin.sim.gait.reference import Reference
from stridetwin.sim.wearer.exo_couplings import exo_couplings
from stridetwin.streams.algebra.tuples import cross, minus, plus, store_vec3, times, vec3
from stridetwin.streams.compiled import entry_kernel
from stridetwin.streams.samples import Array

_entry_kernel = entry_kernel(Path(__file__).parent, llvm_level=1)

STEP_S = DRIVER_S  # time step of the physics
_SETTLE_S = 0.2  # on its soles, before the walk begins
MARGIN_S = 2.0 * STEP_S
"""Future steps can still change the splines this long before them."""
_STEPS_PER_CONTROL = round(CONTROL_S / STEP_S)  # physics steps in a period of the controller
_FALLEN_M = 0.25  # the pelvis this far below its plan


class Simulation:
    """A walk that is simulated in steps of `STEP_S`.

    Args:
        model: Model with soles; contacts are off outside the simulation.
        reference: The planned motion.
        plan: The reference at the control rate.
        dynamics: Assistance and disturbances.
        exo: The exoskeleton and its drive; the wearer is used to it and knows the torques of its motors.
        rng: Noise of the joint torques.
        law: Control law that replaces the drive of `exo`.

    Attributes:
        fell_at: Time at which the walker fell, s; None while they walk.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        reference: Reference,
        plan: Plan,
        dynamics: Dynamics,
        exo: Exo | None,
        rng: np.random.Generator,
        law: ControlLaw | None = None,
    ) -> None:
        """Prepares model, controller, couplings and drive, and places the walker at the start of the plan."""
        self._plan = plan
        # by instant of the plan: (N, 2) N on the pelvis, and (N, 2, 2) m, offset of each foot's landing
        self._push_forces, self._landing_offsets = push_forces(dynamics, plan), misstep_offsets(dynamics, plan)
        self._reference, self._noise, self._rng = reference, dynamics.torque_noise, rng
        self._model = model = _set_physics_options(apply_disturbances(model, dynamics))
        self._data = data = mujoco.MjData(model)
        self._state = State.of(data)
        self._control = Controller(
            model,
            reference.size,
            reference.coordinates,
            Gains(),
            assist=dynamics.assist,
            mass_ratio=1.0 / (1.0 + dynamics.mass_error),
        )
        self._coupled = CouplingSet.of(model, exo_couplings(reference.size))
        # number of steps of the walk, and of the next one; negative while the walker settles on their soles
        self._steps, self._step = round(reference.duration_s / STEP_S), -round(_SETTLE_S / STEP_S)
        self._soles = sole_point_numbers(model)  # (ngeom,) number of each geom as a sole point; -1 for others
        self._record = _Record(self._steps, model, self._soles)
        self._welded = model.body_weldid[model.geom_bodyid]  # (ngeom,) body of each geom, 0 if fixed to the world
        self._drive = Drive(model, exo, law)
        self._chains = np.array([chain_of(model, body) for body in range(model.nbody)])  # (nbody, nv)
        data.qpos, data.qvel = plan.q[0], plan.v[0]
        data.qpos[2] += max(dynamics.floor_offset_m, 0.0)  # not inside a floor that is higher than planned
        self._pushed = data.xfrc_applied[model.body("pelvis").id]  # a view: writing to it pushes the pelvis
        # results of the last control step: the wearer's generalised forces, and the shifts of feet and pelvis
        self._torque, self._shift = np.zeros(model.nv), StepReplan.none()
        # (2, points) which sole points might bear force in the last control step
        self._touching = np.zeros((len(SIDES), PER_FOOT), dtype=bool)
        self.fell_at: float | None = None

    @property
    def is_over(self) -> bool:
        """Whether the walk has ended or the walker has fallen."""
        return self.fell_at is not None or self._step >= self._steps

    @property
    def time_s(self) -> float:
        """Time of the walk; below 0 while the walker settles on their soles."""
        return self._step * STEP_S

    def step(self) -> None:
        """Advances the simulation by `STEP_S`: couplings, motors, the wearer's torques and contacts.

        The controller runs at every `CONTROL_S`; its torques are held in between. States and contacts are recorded from
        time 0 on. If the pelvis is far below its plan, `fell_at` is set, and the walk is over.
        """
        model, data, plan, step = self._model, self._data, self._plan, self._step
        # positions, velocities and contacts of this instant; `mj_step2` then computes forces and the next state
        mujoco.mj_step1(model, data)
        # (nv,) generalised forces of couplings and motors, which the wearer knows
        known = coupling_forces(self._coupled, self._state)
        motors = self._drive.torques(data)
        known += motors
        i = min(max(step, 0) // _STEPS_PER_CONTROL, len(plan.t) - 1)  # row of the plan; the first while settling
        if step % _STEPS_PER_CONTROL == 0:
            self._control_step(i, known)
        data.qfrc_applied = self._torque + known
        if step >= 0:
            self._record.record_state(step, data, self._torque + motors)
        subtract_bias(self._welded, self._chains, Contacts.of(data), self._state, data.efc_aref)
        mujoco.mj_step2(model, data)
        if step >= 0:
            self._record.record_contacts(step, data)
        # the root's height against its plan, which the replanned steps shift
        if data.qpos[2] < plan.q[i, 2] + self._shift.root[0, 2] - _FALLEN_M:
            self.fell_at = step * STEP_S
        self._step = step + 1

    def _control_step(self, i: int, known: Array) -> None:
        """Computes the wearer's torques for the next control period, and sets the push on the pelvis.

        It updates the touching sole points, the shifts of the footsteps, and the torques.

        Args:
            i: Row of the plan.
            known: (nv,) generalised forces of couplings and motors, which the wearer knows.
        """
        model, data, plan = self._model, self._data, self._plan
        feet = plan.feet_at(i)
        self._touching, floor = sense_floor(self._soles, Contacts.of(data), feet, self._touching)
        mujoco.mj_subtreeVel(model, data)
        # horizontal centre of mass and its velocity, minus the plan's
        com = np.array([data.subtree_com[1, :2], data.subtree_linvel[1, :2]]) - plan.com[i]
        pressing = np.logical_or.reduce(self._touching, axis=1)  # (2,) whether any point of a foot may bear force
        advance_shifts(self._shift, CONTROL_S, feet, com, floor, pressing, self._landing_offsets[i])
        self._torque = self._control.torques(
            data, self._state, plan, i, self._shift, self._touching, known, self._record.lift(self._step - 1)
        )
        if self._noise:
            # noise of the joints in proportion to their torque; the root's six entries have none
            self._torque[6:] *= 1.0 + self._noise * self._rng.standard_normal(model.nv - 6)
        self._pushed[:2] = self._push_forces[i]

    def recent(self, seconds: float) -> SimulatedWalk:
        """The last `seconds` of the walk so far; the splines of its last `MARGIN_S` may still change."""
        first = max(self._step - round(seconds / STEP_S), 0)  # step 0 is the first that is recorded
        return SimulatedWalk.of_part(self._reference, *self._record.rows(first, self._step))

    def walk(self) -> SimulatedWalk:
        """The walk so far, with the footsteps and foot pitch of the simulation."""
        return SimulatedWalk.of(self._reference, *self._record.rows(0, self._step), self.fell_at)


def apply_disturbances(model: mujoco.MjModel, dynamics: Dynamics) -> mujoco.MjModel:
    """Copy of a model with the true body mass, floor height and friction of the soles, which the controller ignores."""
    model = copy.copy(model)
    model.body_mass *= 1.0 + dynamics.mass_error
    model.body_inertia *= 1.0 + dynamics.mass_error
    mujoco.mj_setConst(model, mujoco.MjData(model))  # what the model derives from the masses
    for i in range(model.ngeom):
        name = model.geom(i).name  # the floor is the plane `ground` and the solids `terrain_<i>`
        if name == "ground" or name.startswith("terrain_"):
            model.geom_pos[i, 2] += dynamics.floor_offset_m
        elif name.startswith("sole_"):
            model.geom_friction[i, 0] = dynamics.friction
    return model


def push_forces(dynamics: Dynamics, plan: Plan) -> Array:
    """(N, 2) N, horizontal force of all pushes on the pelvis at each instant of a plan, world axes."""
    force = np.zeros((len(plan.t), 2))
    for push in dynamics.pushes:
        during = (plan.t >= push.at_s) & (plan.t < push.at_s + push.duration_s)
        # from forward and left of the way to the world's axes
        force[during] += plan.feet.R_way[during] @ [push.forward_n, push.left_n]
    return force


def misstep_offsets(dynamics: Dynamics, plan: Plan) -> Array:
    """(N, 2, 2) m, offset of each foot's landing from its foothold at each instant of a plan, world axes.

    A misstep moves the first landing after its time, for as long as that foot is in the air.
    """
    offsets = np.zeros((len(plan.t), len(SIDES), 2))
    for misstep in dynamics.missteps:
        # (N, 2) s, time of the next landing of each foot in the air; inf for a foot on the ground
        landing = plan.t[:, None] + plan.feet.until_landing
        landing[~plan.feet.swinging | (landing < misstep.at_s)] = np.inf
        first = landing.min()
        if not np.isfinite(first):
            continue  # the last foot has already landed
        foot = int(landing.min(axis=0).argmin())  # the foot that lands first: 0 left, 1 right
        during = np.isclose(landing[:, foot], first)  # the swing that ends with this landing
        offsets[during, foot] += plan.feet.R_way[during] @ [misstep.forward_m, misstep.left_m]
    return offsets


def _set_physics_options(model: mujoco.MjModel) -> mujoco.MjModel:
    """Sets time step, integrator, friction cones and contacts of a model in place, and returns it."""
    model.opt.timestep = STEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    model.opt.impratio = 50.0  # reduces the creep of stance feet
    for side in SIDES:
        model.dof_damping[model.joint(f"toe_extension_{side}").dofadr[0]] = TOE_DAMPING
    # contacts on, MuJoCo's own sensors off
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
    return model


class _Record:
    """States and contact loads of all steps of a simulation, in arrays that are filled as it runs.

    Args:
        n: Number of steps.
        model: The simulated model.
        soles: (ngeom,) numbers of the sole points (`sole_point_numbers`).
    """

    def __init__(self, n: int, model: mujoco.MjModel, soles: NDArray[np.int64]) -> None:
        """Allocates a row for each of `n` steps; `soles` (ngeom,) are the numbers of the sole points, -1 for others."""
        self._q, self._torque = np.empty((n, model.nq)), np.empty((n, model.nv))
        shape = n, len(SIDES), 3
        self._loads = FootRecord(
            R=np.empty((*shape, 3)),
            p=np.empty(shape),
            force=np.zeros(shape),
            moment=np.zeros(shape),
            cop=np.zeros(shape),
        )
        self._feet = np.array([model.body(f"foot_{side}").id for side in SIDES])
        self._side = np.where(soles < 0, -1, soles // PER_FOOT)  # foot of each geom, 0 or 1; -1 for other geoms

    def record_state(self, i: int, data: mujoco.MjData, torque: Array) -> None:
        """Stores the position and the (nv,) generalised forces at the start of step i."""
        self._q[i], self._torque[i] = data.qpos, torque

    def record_contacts(self, i: int, data: mujoco.MjData) -> None:
        """Stores the contact loads of step i, after `mj_step2`, which computes their forces."""
        _record_foot_loads(
            self._side, self._feet, data.xpos, data.xmat, Contacts.of(data), data.efc_force, self._loads.at(i)
        )

    def lift(self, i: int) -> float:
        """Vertical force of both feet in step i, N; 0 before the walk."""
        return float(self._loads.force[i, :, 2].sum()) if i >= 0 else 0.0

    def rows(self, first: int, end: int) -> tuple[Array, Array, Array, FootRecord]:
        """Records of the K steps from `first` to before `end`.

        Returns:
            (K,) s; (K, nq) positions; (K, nv) generalised forces of the joints; loads of the feet with K rows.
        """
        rows = slice(first, end)
        return STEP_S * np.arange(first, end, dtype=float), self._q[rows], self._torque[rows], self._loads.at(rows)


@_entry_kernel
def _record_foot_loads(
    side: NDArray[np.int64],
    feet: NDArray[np.int64],
    xpos: Array,
    xmat: Array,
    contacts: Contacts,
    efc_force: Array,
    loads: FootRecord,
) -> None:
    """Writes the frames of both feet, the contact wrench on each foot, and the centre of pressure.

    The force is the sum of the contact forces, the moment is about the foot's origin, and the centre of pressure is the
    mean of the contact points weighted by their normal forces; all are in world axes.

    Args:
        side: (ngeom,) foot of each sole geom, 0 or 1; -1 for other geoms.
        feet: (2,) bodies of the feet.
        xpos: (nbody, 3) m.
        xmat: (nbody, 9).
        contacts: The engine's contacts.
        efc_force: (nefc,) constraint forces.
        loads: Output of one step, initially 0.
    """
    geoms, pos, frame, _, address = contacts  # `address`: first row of a contact's force, -1 for none
    R_feet, p_feet, force, moment, cop = loads
    for s in range(2):
        store_vec3(vec3(xpos[feet[s]]), p_feet[s])
        for k in range(9):
            R_feet[s, k // 3, k % 3] = xmat[feet[s], k]
    # first the sum of the contact points weighted by their normal forces; `lift` is the sum of these forces
    lift = np.zeros(2)
    for c in range(len(address)):
        if address[c] < 0:
            continue  # surfaces that are near but exert no force
        first = side[geoms[c, 0]] >= 0  # whether the sole is the first of the two geoms
        s = side[geoms[c, 0]] if first else side[geoms[c, 1]]
        if s < 0:
            continue  # not a contact of a sole
        # three rows of force per contact: along the normal, then along the two other axes of the contact's frame
        contact_force, point, normal_force = (0.0, 0.0, 0.0), vec3(pos[c]), efc_force[address[c]]
        for axis in range(3):
            f = efc_force[address[c] + axis]
            contact_force = plus(
                contact_force, times(f, (frame[c, 3 * axis], frame[c, 3 * axis + 1], frame[c, 3 * axis + 2]))
            )
        contact_force = times(-1.0 if first else 1.0, contact_force)  # the frame's first axis leaves the first geom
        store_vec3(plus(vec3(force[s]), contact_force), force[s])
        store_vec3(plus(vec3(moment[s]), cross(minus(point, vec3(p_feet[s])), contact_force)), moment[s])
        store_vec3(plus(vec3(cop[s]), times(normal_force, point)), cop[s])
        lift[s] += normal_force
    for s in range(2):  # the sum becomes the mean; without load it stays 0
        if lift[s] > 0.0:
            store_vec3(times(1.0 / lift[s], vec3(cop[s])), cop[s])
