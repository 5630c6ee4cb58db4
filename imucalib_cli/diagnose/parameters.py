"""Which joint zeros or link lengths, changed a little, would explain what a fit leaves over.

Each is one more column of the residual, found by differences of the chain. The pose, biases, tilt
and time offset are eliminated first: what only shifts the world, or slides into the mount, has no
column left and is never named.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.diagnose.edits import (
    joints_of,
    origin_lengths,
    with_longer_origins,
    with_zeros,
)
from imucalib_cli.estimate.fit import make_unknowns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from imucalib_cli.diagnose.bench import Bench, Trial
    from imucalib_cli.robot.path import KinematicPath

Floats = NDArray[np.float64]

_STEP = 1e-4
"""rad or m, of the central difference."""
_SHORTEST_ORIGIN = 0.01
"""m: shorter origins have no direction worth the name."""
_VISIBLE = 3e-3
"""Share of a column's length that must be left once the pose is eliminated."""
_MOST = 3
_MANY = 18
_ITERATIONS = 4
_EXPLAINED = 0.05
"""Share of the excess cost that may be left."""
_ROUGHLY = 0.3
"""The same while the chain is still linearised far from the answer."""
_ONE_MORE = (0.9, 200.0)
"""Ratio of costs, and fall in units of the noise, for which one more parameter is named."""
_DISTINCT = (0.95, 60.0)
"""The same, for which another set of as many is ruled out."""
_FALL = 0.1
_NEAR_NOISE = 4.0
"""Remaining cost, of the cost as told or per degree of freedom of white noise, of a good fit."""
_SIGNIFICANT = 200.0
"""Fall of the cost, in units of what remains per degree of freedom: windows overlap by half."""
_LARGEST = {"zero": 1.0, "length": 0.3}
"""rad and m."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A constant of the chain."""

    kind: Literal["zero", "length"]
    joint: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Explanation:
    """Parameters, changed, that explain what was left over."""

    values: dict[Parameter, float]
    """rad or m, true less told."""
    trial: Trial
    rivals: tuple[dict[Parameter, float], ...]
    """Others that do nearly as well."""


def parameters_of(path: KinematicPath) -> tuple[Parameter, ...]:
    """Zeros of all joints, and lengths of all origins between moving steps."""
    names = dict.fromkeys(step.name for step in joints_of(path))
    lengths = origin_lengths(path)
    return (
        *(Parameter(kind="zero", joint=name) for name in names),
        *(
            Parameter(kind="length", joint=name)
            for name in names
            if lengths.get(name, 0.0) > _SHORTEST_ORIGIN
        ),
    )


def with_parameters(path: KinematicPath, values: Mapping[Parameter, float]) -> KinematicPath:
    """The same path with its constants changed."""
    zeros = {p.joint: value for p, value in values.items() if p.kind == "zero"}
    lengths = {p.joint: value for p, value in values.items() if p.kind == "length"}
    return with_longer_origins(with_zeros(path, zeros), lengths)


def explain_by_parameters(bench: Bench, start: Trial) -> Explanation | None:
    """Find the fewest constants of the chain that explain what a trial leaves over.

    Args:
        bench: Of the trial.
        start: The kinematics as told, fitted.

    Returns:
        None where no few of them do, or where nothing is left to explain.
    """
    parameters = parameters_of(start.path)
    if not parameters:
        return None
    trial, values = start, dict[Parameter, float]()
    for turn in range(_ITERATIONS):
        system = _linearise(bench, trial, parameters, values)
        if turn == 0 and not system.worth_explaining:
            break
        share = _ROUGHLY if turn == 0 else _EXPLAINED
        chosen = system.fewest(share)
        if chosen is None and turn > 1:
            break
        before, values = values, system.solve(chosen or system.best(system.most))
        if any(abs(value) > _LARGEST[p.kind] for p, value in values.items()):
            break
        following = bench.trial(with_parameters(start.path, values), near=trial)
        if following is None:
            break
        trial = following
        moved = max(abs(values.get(p, 0.0) - before.get(p, 0.0)) for p in {*values, *before})
        if chosen is not None and turn > 0 and (moved < _STEP or turn == _ITERATIONS - 1):
            rivals = tuple(system.solve(other) for other in system.rivals(chosen))
            return Explanation(values=values, trial=trial, rivals=rivals)
    return None


@dataclass(frozen=True, eq=False)
class _System:
    """Cost as a quadratic function of the parameters, pose and nuisances eliminated."""

    parameters: tuple[Parameter, ...]
    seen: tuple[int, ...]
    """Indices of the parameters that are not absorbed by the pose."""
    gram: Floats
    rhs: Floats
    cost: float
    """With no parameter changed."""
    freedom: float

    def remaining(self, some: tuple[int, ...]) -> float:
        """Cost with some of the parameters at their best."""
        if not some:
            return self.cost
        index = list(some)
        return max(self.cost - float(self.rhs[index] @ self._values(index)), 0.0)

    def _values(self, index: list[int]) -> Floats:
        """Least squares of least norm, columns scaled to one."""
        scale = np.sqrt(np.diag(self.gram)[index])
        gram = self.gram[np.ix_(index, index)] / np.outer(scale, scale)
        inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
        return np.asarray(inverse @ (self.rhs[index] / scale) / scale)

    @property
    def floor(self) -> float:
        """Cost with all parameters at their best."""
        return self.remaining(self.seen)

    @property
    def most(self) -> int:
        """Largest set that is looked for: fewer where there are many to choose from."""
        return min(len(self.seen), _MOST if len(self.seen) <= _MANY else _MOST - 1)

    @property
    def worth_explaining(self) -> bool:
        """Whether all parameters together explain it, and plainly."""
        if not self.seen:
            return False
        floor = self.floor
        each = max(floor / self.freedom, 0.1)
        good = floor < _ROUGHLY * self.cost or floor < _NEAR_NOISE * self.freedom
        return good and self.cost - floor > _SIGNIFICANT * each

    def explained(self, some: tuple[int, ...], share: float) -> bool:
        """Whether some parameters leave little of what all of them explain, and that is much."""
        left, floor = self.remaining(some), self.floor
        good = left < _FALL * self.cost or left < _NEAR_NOISE * self.freedom
        enough = left - floor < share * (self.cost - floor)
        each = max(left / self.freedom, 0.1)
        return good and enough and self.cost - left > _SIGNIFICANT * each

    def fewest(self, share: float) -> tuple[int, ...] | None:
        """The smallest set that explains, unless one more leaves plainly less."""
        found = None
        for count in range(1, self.most + 1):
            best = self.best(count)
            if found is not None and not self.better(best, found, _ONE_MORE):
                return found
            found = best if self.explained(best, share) else None
        return found

    def better(self, one: tuple[int, ...], other: tuple[int, ...], by: tuple[float, float]) -> bool:
        """Whether one set leaves less than another, by a ratio and in units of the noise."""
        left, more = self.remaining(one), self.remaining(other)
        each = max(left / self.freedom, 0.1)
        return left < by[0] * more and more - left > by[1] * each

    def best(self, count: int) -> tuple[int, ...]:
        """The set of a size that leaves least."""
        return min(itertools.combinations(self.seen, count), key=self.remaining)

    def rivals(self, chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Other sets of the same size that leave hardly more, best first."""
        others = itertools.combinations(self.seen, len(chosen))
        sets = [o for o in others if o != chosen and not self.better(chosen, o, _DISTINCT)]
        return sorted(sets, key=self.remaining)

    def solve(self, some: tuple[int, ...]) -> dict[Parameter, float]:
        """Values at the least cost."""
        index = list(some)
        found = self._values(index)
        return {self.parameters[i]: float(v) for i, v in zip(index, found, strict=True)}


def _linearise(
    bench: Bench, trial: Trial, parameters: tuple[Parameter, ...], values: dict[Parameter, float]
) -> _System:
    """Residuals about a trial as a linear function of the parameters' whole values."""
    x = trial.solution.state.vector()
    root = np.sqrt(trial.weights)
    e = _whitened(trial.rows.residuals(x), root, bench.noise)
    tangent = trial.solution.state.jacobian()
    free = make_unknowns(bench.options, offset_free=bench.options.time_offset is None).free
    J = np.concatenate(
        [trial.rows.accel @ tangent / bench.noise[0], trial.rows.gyro @ tangent / bench.noise[1]],
        axis=1,
    )[:, :, free]
    J = (J * root[:, None, None]).reshape(len(e), -1)
    C = np.stack([_column(bench, trial, parameter, x, root) for parameter in parameters], axis=1)
    e = e - C @ np.array([values.get(parameter, 0.0) for parameter in parameters])
    basis = _basis(J)
    lengths = np.linalg.norm(C, axis=0)
    C = C - basis @ (basis.T @ C)
    e = e - basis @ (basis.T @ e)
    kept = np.linalg.norm(C, axis=0)
    seen = np.flatnonzero(kept > _VISIBLE * np.maximum(lengths, 1e-300))
    return _System(
        parameters=parameters,
        seen=tuple(int(index) for index in seen),
        gram=C.T @ C,
        rhs=-(C.T @ e),
        cost=float(e @ e),
        freedom=float(6.0 * trial.weights.sum()),
    )


def _column(bench: Bench, trial: Trial, parameter: Parameter, x: Floats, root: Floats) -> Floats:
    sides = []
    for step in (_STEP, -_STEP):
        path = with_parameters(trial.path, {parameter: step})
        trajectory = replace(trial.windowing.trajectory, path=path)
        windowing = replace(trial.windowing, trajectory=trajectory)
        left = windowing.residuals(trial.time_offset, trial.rows.centres, x)
        sides.append(_whitened(left, root, bench.noise))
    return np.asarray((sides[0] - sides[1]) / (2.0 * _STEP))


def _whitened(residuals: tuple[Floats, Floats], root: Floats, noise: tuple[float, float]) -> Floats:
    both = np.concatenate([residuals[0] / noise[0], residuals[1] / noise[1]], axis=1)
    return np.asarray((both * root[:, None]).reshape(-1))


def _basis(J: Floats) -> Floats:
    """Orthonormal columns that span those of J."""
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    U, values, _ = np.linalg.svd(J / scale, full_matrices=False)
    return np.asarray(U[:, values > 1e-9 * values[0]])
