"""Reference solution of a scene: its motion in float64 up to a horizon, with an estimate of its error.

The motion is that of velocity Verlet in drift–kick–drift form with short steps, of second order:

    x½ = x + h/2·v;   v' = v + h·a(x½, …);   x' = x½ + h/2·v'          (Hairer, Lubich and Wanner 2003, eq. 1.5)

Forces that depend on velocity keep the order: damping and spring dampers are solved implicitly at the mean velocity of
the step, and wind forces use a velocity predicted for the middle of the step. Contacts, tethers and max distances are
constraints on v' and x'. They are of first order in h where they start to act.

The solution takes three runs: one with steps that are short compared to the fastest vibration, one with these steps and
a slightly disturbed start, and one with half the step. The first two give the horizon, beyond which the motion is
chaotic: a small disturbance has grown into a different motion. The first and the third show how much the result still
depends on the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf

import numpy as np
from numpy.typing import NDArray

from ...geometry.cloth_builder import attachment_ids, build_particles
from ...geometry.spring_model import Bools, Floats, Ints, SpringModel, spring_model, wind_of
from ...geometry.tethers import tethers_of
from ...scene.collider_schema import Capsule, Sphere
from ...scene.schema import COLLIDERS, FRAME_SECONDS, Scene
from .unilateral_contact import (
    ColliderState,
    Pose,
    TriangleContact,
    contact_velocity_change,
    obstacles_of,
    pose,
    project_to_margin,
    repulsion_velocity_change,
)

CG_TOLERANCE, MAX_CG_ITERATIONS = 1e-8, 500  # relative residual and iterations of the damper equations


@dataclass(frozen=True, eq=False)
class DistanceBound:
    """An upper bound on the distance of every particle from its pin (tether) or from its start (max distance)."""

    pins: Ints | None
    """The pin of every particle, (N,), or None for a bound on the distance from the start."""
    start: Floats
    """Start positions [m], (3, N)."""
    max_distance: Floats
    """Largest distance [m], (N,)."""

    def anchor_positions(self, x: Floats) -> Floats:
        """Return the positions that distances are measured from [m], (3, N)."""
        return self.start if self.pins is None else x[:, self.pins]

    def anchor_velocities(self, v: Floats) -> Floats | float:
        """Return the velocities of the points that distances are measured from [m/s], (3, N), or 0 if fixed."""
        return 0.0 if self.pins is None else v[:, self.pins]


class Motion:
    """The motion of one scene's cloth. `x` and `v` are positions [m] and velocities [m/s], (3, N)."""

    def __init__(self, scene: Scene, steps: int, shake: Floats | float = 0.0) -> None:
        """`steps` is the number of steps per frame. `shake` [m], (3, N), is added to the start of free particles."""
        self._scene = scene
        self._model = model = spring_model(scene)
        self._air = wind_of(scene, model)
        self._h = FRAME_SECONDS / steps
        self._steps_per_frame, self._steps_done = steps, 0
        self._obstacles = obstacles_of(scene)
        owner = attachment_ids(scene, model.topology)
        self._attached = [(attachment, np.flatnonzero(owner == k)) for k, attachment in enumerate(scene.attachments)]
        self._local = [
            pose(attachment, 0.0).local(model.start[:, particles]) for attachment, particles in self._attached
        ]
        self._free = model.free
        self._triangle_contacts = self._make_triangle_contacts()
        self._bounds = self._make_bounds()
        self._velocity_change = np.zeros_like(
            model.start
        )  # [m/s] by forces in the last step: first guess for the next one
        self.x = model.start + shake * self._free
        self.v = np.zeros_like(self.x)

    def _make_bounds(self) -> list[DistanceBound]:
        """Return the bounds of tethers and max distances."""
        model, bounds = self._model, []
        if self._scene.tethers is not None:
            for pins, reach in zip(*tethers_of(model.topology), strict=True):
                bounds.append(DistanceBound(pins.astype(np.int64), model.start, reach * self._scene.tethers.slack))
        if model.topology.max_distance is not None:
            bounds.append(DistanceBound(None, model.start, model.topology.max_distance))
        return bounds

    def _make_triangle_contacts(self) -> list[TriangleContact]:
        """Return the contacts of the colliders that collide with triangles."""
        model, scene = self._model, self._scene
        corners, inverse_mass = model.topology.triangles.T.astype(np.int64), self._free / model.mass
        colliders: list[Sphere | Capsule] = [*scene.spheres, *scene.capsules]
        return [TriangleContact(one, corners, inverse_mass) for one in colliders if one.collide_with == "triangles"]

    def step_frame(self) -> Floats:
        """Advance by one frame and return the positions [m], (N, 3)."""
        for _ in range(self._steps_per_frame):
            self._advance()
        return self.x.T.copy()

    @property
    def strain(self) -> float:
        """Largest strain of all springs."""
        return float(self._model.strains(self.x).max(initial=0.0))

    def _advance(self) -> None:
        h, model = self._h, self._model
        middle, end = (self._steps_done + 0.5) * h, (self._steps_done + 1) * h
        self._steps_done += 1
        x = self.x + h / 2 * self.v
        v = self.v.copy()
        self._drive_attached(x, v, middle)
        force = model.elastic_force(x) + model.weight()
        if self._air is not None:
            force += self._air.force(x, v + self._velocity_change / 2, middle)
        for obstacle in self._obstacles:
            if obstacle.collider.response == "repulsion":
                collider_pose, density = obstacle.pose(middle), self._scene.cloth.area_density
                force += model.mass / h * repulsion_velocity_change(obstacle, x, v, collider_pose, h, density)
        self._velocity_change = self._solve_velocity_change(x, v, force)
        v = v + self._velocity_change
        self._finish_step(x, v, end)

    def _drive_attached(self, x: Floats, v: Floats, seconds: float) -> None:
        """Set attached particles of `x` and `v` to the pose of their attachment, in place."""
        for (attachment, particles), local in zip(self._attached, self._local, strict=True):
            target = pose(attachment, seconds)
            x[:, particles] = target.center[:, None] + target.axes @ local
            v[:, particles] = target.surface_velocity(x[:, particles])

    def _solve_velocity_change(self, x: Floats, v: Floats, force: Floats) -> Floats:
        """Return the velocity change of one step [m/s], (3, N).

        It is that of free particles under all forces, with damping at the mean velocity.
        """
        h, model = self._h, self._model
        damping = h / 2 * self._scene.solver.damping
        right = (h * force - 2 * damping * model.mass * v) * self._free
        if model.damping_time == 0:
            change: Floats = right / (model.mass * (1 + damping))
            return change
        dampers = model.dampers(x)

        def damper_force(u: Floats) -> Floats:
            """Return the force of all dampers on every particle [N], (3, N), at velocities `u` [m/s]."""
            force = model.damper_force(dampers, u)
            return force if model.membrane is None else force + model.membrane.damper_force(x, u, model.damping_time)

        right += h * damper_force(v) * self._free
        return self._solve_implicit(damper_force, dampers, model.mass * (1 + damping), right)

    def _solve_implicit(
        self, damper_force: Callable[[Floats], Floats], dampers: Floats, mass: Floats, right: Floats
    ) -> Floats:
        """Solve (mass − h/2·∂f/∂v)·u = right for u [m/s], (3, N), with the damper forces f.

        Conjugate gradients, preconditioned with masses and the diagonal of `dampers`, those of the springs. They start
        from the velocity change of the last step. Raises ArithmeticError if they do not converge.
        """

        def apply(u: Floats) -> Floats:
            product: Floats = (mass * u - self._h / 2 * damper_force(u)) * self._free
            return product

        ends, count = self._model.ends[:, : dampers.shape[1]].reshape(-1), len(mass)
        squares = np.concatenate([dampers**2, dampers**2], axis=1)
        diagonal = mass + self._h / 2 * np.stack([np.bincount(ends, component, count) for component in squares])
        u = self._velocity_change.copy()
        residual = right - apply(u)
        tolerance = CG_TOLERANCE**2 * float((right * right / diagonal).sum())
        direction = preconditioned = residual / diagonal
        squared = float((residual * preconditioned).sum())
        for _ in range(MAX_CG_ITERATIONS):
            if squared <= tolerance:
                return u
            image = apply(direction)
            step = squared / float((direction * image).sum())
            u += step * direction
            residual -= step * image
            preconditioned = residual / diagonal
            last, squared = squared, float((residual * preconditioned).sum())
            direction = preconditioned + squared / last * direction
        raise ArithmeticError("conjugate gradients did not converge on the equations of the spring dampers")

    def _finish_step(self, x: Floats, v: Floats, seconds: float) -> None:
        """Do the second half of the drift, with the constraints on its end: tethers, max distances, contacts."""
        h = self._h
        max_speed = float(np.sqrt(max((self.v**2).sum(axis=0).max(), (v**2).sum(axis=0).max())))
        ends = x + h / 2 * v
        self._drive_attached(ends, v, seconds)
        for bound in self._bounds:
            direction, excess = self._excess(bound, ends)
            speed = np.maximum(((v - bound.anchor_velocities(v)) * direction).sum(axis=0), 0.0) * (excess > 0)
            v -= speed * direction * self._free
        contacts: list[tuple[ColliderState, Pose, Bools]] = []
        for obstacle in self._obstacles:
            if obstacle.collider.response != "repulsion" and not obstacle.is_out_of_reach(max_speed, h):
                collider_pose = obstacle.pose(seconds)
                touching, change = contact_velocity_change(obstacle, x + h / 2 * v, v, collider_pose)
                touching &= self._free
                v += change * self._free
                if touching.any() and obstacle.collider.response == "projection":
                    contacts.append((obstacle, collider_pose, touching))
        ends = x + h / 2 * v
        within = [contact.stop_approach(ends, v, seconds) for contact in self._triangle_contacts]
        x = x + h / 2 * v
        self._drive_attached(x, v, seconds)
        for bound in self._bounds:
            direction, excess = self._excess(bound, x)
            x -= np.maximum(excess, 0.0) * direction * self._free
        for obstacle, collider_pose, touching in contacts:
            x = np.where(touching, project_to_margin(obstacle, x, collider_pose), x)
        for triangle_contact, triangles in zip(self._triangle_contacts, within, strict=True):
            triangle_contact.project(x, seconds, triangles)
        self.x, self.v = x, v

    def _excess(self, bound: DistanceBound, x: Floats) -> tuple[Floats, Floats]:
        """Return the direction of every particle from the other end of its bound, (3, N), and its excess [m], (N,).

        The excess is how much farther away the particle is than allowed; it is negative within the bound.
        """
        gap = x - bound.anchor_positions(x)
        distance = np.sqrt((gap * gap).sum(axis=0))
        return gap / np.where(distance > 0, distance, 1.0), distance - bound.max_distance


DISTURBANCE = 1e-9  # disturbance of the start, as a share of the longer side
MAX_GROWTH = 100.0  # growth of the disturbance at the horizon
MAX_PHASE = 0.9  # [rad] largest phase of the fastest vibration in a step of the coarser run; the stability limit is 2


@dataclass(frozen=True, eq=False)
class Solution:
    """Positions after each frame up to the horizon [m], (frames, N, 3), from two runs."""

    positions: Floats
    """Positions of the run with steps h/2."""
    coarse_positions: Floats
    """Positions of the run with steps h."""
    side: float
    """The longer side of the sheet [m]."""

    @property
    def horizon(self) -> int:
        """Number of frames up to the horizon."""
        return len(self.positions)

    @property
    def uncertainty(self) -> tuple[float, float]:
        """Distance between the two runs as a share of the side, root mean square and maximum.

        It is at least the error of `positions` if halving the step at least halves the error.
        """
        difference = distances(self.positions, self.coarse_positions) / self.side
        return float(np.sqrt((difference**2).mean())), float(difference.max())


def distances(a: Floats, b: Floats) -> Floats:
    """Return the distance of every particle in every frame [m], (frames, N)."""
    result: Floats = np.linalg.norm(a - b, axis=2)
    return result


MAX_START_DEPTH = 1e-5  # [m] of a particle on a margin, by the rounding of its position


def reason_unsupported(scene: Scene) -> str:
    """Return why a scene has no reference solution, or an empty string if it has one."""
    if scene.fabric.model == "weave" and scene.solver.name != "verlet":
        return "weaves are not in the reference"
    if scene.self_collision is not None:
        return "self-collision is not in the reference"
    if starts_in_contact(scene):
        return "cloth that starts inside a collider's margin is let out slowly, which is not in the reference"
    return ""


def starts_in_contact(scene: Scene) -> bool:
    """Return whether a free particle starts within the margin of a collider that projects positions."""
    model = spring_model(scene)
    free = model.start[:, model.free]
    obstacles = [one for one in obstacles_of(scene) if one.collider.response == "projection"]
    return any(bool((one.gap(free, one.pose(0.0))[0] < -MAX_START_DEPTH).any()) for one in obstacles)


def max_frequency(model: SpringModel) -> float:
    """Return an upper bound of the angular frequencies of the cloth [rad/s] (Gershgorin)."""
    count = len(model.mass)
    stiffness = np.concatenate([model.stiffness, np.abs(model.bending)])
    total = 2 * np.bincount(model.ends.reshape(-1), np.tile(stiffness, 2), count)
    if model.membrane is not None:
        corners, matrices = model.membrane.scalar_elements()
        total += np.bincount(corners.reshape(-1), np.abs(matrices).sum(axis=2).reshape(-1), count)
    return float(np.sqrt((total / model.mass)[model.free].max(initial=0.0)))


def steps_per_frame(scene: Scene) -> int:
    """Return the number of steps per frame of the coarser run."""
    repulsion = sum(one.stiffness for name in COLLIDERS for one in getattr(scene, name) if one.response == "repulsion")
    omega = np.hypot(max_frequency(spring_model(scene)), np.sqrt(repulsion / scene.cloth.area_density))
    return max(8, ceil(FRAME_SECONDS * float(omega) / MAX_PHASE))


def solve(scene: Scene, frames: int) -> Floats:
    """Return `Solution.positions` and `Solution.coarse_positions`, (2, horizon, N, 3), for at most `frames` frames.

    Raises ValueError for a scene without a reference solution.
    """
    if reason := reason_unsupported(scene):
        raise ValueError(f"{scene.name}: {reason}")
    steps, side = steps_per_frame(scene), build_particles(scene).longest_side
    coarser = run_to_horizon(scene, steps, frames, side)
    finer = Motion(scene, 2 * steps)
    return np.stack([[finer.step_frame() for _ in coarser], coarser])


def run_to_horizon(scene: Scene, steps: int, frames: int, side: float) -> NDArray[np.float64]:
    """Return the positions after each frame up to the horizon [m], (frames, N, 3), at least one frame.

    The horizon is where the distance from a run whose start is disturbed by `DISTURBANCE` has grown to `MAX_GROWTH`
    times the disturbance, or where a spring reaches its strain limit or the strain at which it tears, which the
    reference does not model.
    """
    max_strain = min([one.strain for one in (scene.strain_limit, scene.tearing) if one is not None], default=inf)
    run = Motion(scene, steps)
    disturbed = Motion(scene, steps, DISTURBANCE * side * np.random.default_rng(1).standard_normal(run.x.shape))
    positions: list[Floats] = []
    for _ in range(frames):
        x, x_disturbed = run.step_frame(), disturbed.step_frame()
        growth = float(np.sqrt(((x - x_disturbed) ** 2).sum(axis=1).mean())) / (DISTURBANCE * side)
        if positions and (growth > MAX_GROWTH or run.strain > max_strain):
            break
        positions.append(x)
    return np.array(positions)
