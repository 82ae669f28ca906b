"""Trains `scenarios/policies/arm_policy.npz`: the position-based law of `arm_pbvs` cloned on marker
pixels, with DAgger.

    python tests/long/train_policy.py [--out FILE.npz] [--seed 0]

The expert drives first, disturbed so that it also shows how to come back; then the learner drives,
and the expert, which computes its command for every frame of a session, says what it would have
done (`Frame.command`). Marker pixels come from the oracle detector: no picture is rendered. The
starts are those of seeds from 10,000 on; comparisons use those from 0 on.

With seed 0: 360 episodes, 119,000 frames, 175 s of processor time (two minutes on two cores that
are free). From the second round on the learner converged from each of its 60 starts; at the end its
velocities are 0.3 % off the expert's. On rendered pictures: README, "Learned policies".

Reference: Ross, Gordon & Bagnell 2011, "A reduction of imitation learning and structured prediction
to no-regret online learning".
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import vstestbed as vs

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "scenarios" / "policies" / "arm_policy.py"
FIRST_SEED = 10_000
ROUNDS, EPISODES, HIDDEN = 6, 60, 64
STEPS, BATCH = 12_000, 256
LEAST = 2e-3
"""Commands under this [m/s, rad/s] count by their absolute error, larger ones by their relative
one.
"""
spec = importlib.util.spec_from_file_location("arm_policy", POLICY)
arm_policy = importlib.util.module_from_spec(spec)
spec.loader.exec_module(arm_policy)


def drive(seeds, weights, noise):
    """Markers (M, 4, 2) and the expert's velocities (M, 6) of episodes.

    weights: of the learner that drives; None: the expert, with commands disturbed by a random walk
    of relative size `noise`.
    """
    seen, asked, outcomes = [], [], []
    scenario = vs.load("arm_pbvs", {"detector": {"kind": "oracle"}})
    with vs.Session(scenario) as session:
        for seed in seeds:
            rng, wander = np.random.default_rng(seed), np.zeros(6)
            frame = session.reset(seed)
            while frame.outcome is None:
                uv, expert = frame.observation.uv, frame.command.u
                if np.isfinite(uv).all() and not frame.command.rest_reason:
                    seen.append(uv)
                    asked.append(expert)
                wander = 0.9 * wander + noise * np.linalg.norm(expert) * rng.standard_normal(6)
                frame = session.step(
                    expert + wander if weights is None else learner(weights, uv, frame.goal.uv)
                )
            outcomes.append(frame.outcome.name)
    return np.array(seen), np.array(asked), outcomes


def learner(weights, uv, goal):
    """The learner's velocities (6,)."""
    if not np.isfinite(uv).all():
        return np.zeros(6)
    here, there = arm_policy.network(weights, np.stack([uv, goal]))
    return np.clip(here - there, -1, 1)


def first_weights(rng):
    """Weights before training: outputs of about one."""
    sizes = (8, HIDDEN, HIDDEN, 6)
    weights = {
        f"W{i}": rng.standard_normal((a, b)) / np.sqrt(a)
        for i, (a, b) in enumerate(itertools.pairwise(sizes))
    }
    return weights | {"b0": np.zeros(HIDDEN), "b1": np.zeros(HIDDEN)}


def gradient(weights, uv, goal, wanted, scale):
    """Mean squared error of (network(uv) - network(goal) - wanted) / scale, and its gradient by
    back-propagation.
    """
    m = len(uv)
    x = ((np.concatenate([uv, goal[None]]) - arm_policy.CENTRE) / arm_policy.SCALE).reshape(
        m + 1, -1
    )
    h0 = np.tanh(x @ weights["W0"] + weights["b0"])
    h1 = np.tanh(h0 @ weights["W1"] + weights["b1"])
    out = h1 @ weights["W2"]
    error = (out[:-1] - out[-1] - wanted) / scale[:, None]
    d = 2 * error / scale[:, None] / m
    d = np.concatenate([d, -d.sum(axis=0, keepdims=True)])
    g = {"W2": h1.T @ d}
    d = (d @ weights["W2"].T) * (1 - h1**2)
    g |= {"W1": h0.T @ d, "b1": d.sum(axis=0)}
    d = (d @ weights["W1"].T) * (1 - h0**2)
    g |= {"W0": x.T @ d, "b0": d.sum(axis=0)}
    return float((error**2).sum(axis=1).mean()), g


def train(weights, data, goal, rng, steps=STEPS):
    """Adam on the relative error of the velocities, at a rate that falls to nothing; returns the
    weights and the last error.
    """
    uv, wanted = data
    scale = np.linalg.norm(wanted, axis=1) + LEAST
    weights = {k: v.copy() for k, v in weights.items()}
    m, v = ({k: np.zeros_like(w) for k, w in weights.items()} for _ in range(2))
    losses = []
    for t in range(1, steps + 1):
        pick = rng.integers(len(uv), size=BATCH)
        loss, g = gradient(weights, uv[pick], goal, wanted[pick], scale[pick])
        losses.append(loss)
        rate = 3e-3 * (1 + np.cos(np.pi * t / steps)) / 2
        for k in weights:
            m[k] += 0.1 * (g[k] - m[k])
            v[k] += 0.001 * (g[k] ** 2 - v[k])
            weights[k] -= rate * (m[k] / (1 - 0.9**t)) / (np.sqrt(v[k] / (1 - 0.999**t)) + 1e-8)
    return weights, float(np.sqrt(np.mean(losses[-500:])))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=POLICY.with_suffix(".npz"))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, began = np.random.default_rng(options.seed), time.perf_counter()
    goal = vs.load("arm_pbvs").goal_view.uv
    weights, driver, parts = first_weights(rng), None, []
    with ProcessPoolExecutor(2) as pool:
        for number in range(ROUNDS):
            first = FIRST_SEED + 1000 * options.seed + number * EPISODES
            seeds = [range(first + i, first + EPISODES, 2) for i in range(2)]
            done = list(pool.map(drive, seeds, [driver] * 2, [0.12] * 2))
            parts += [(uv, u) for uv, u, _ in done]
            ends = [end for _, _, outcomes in done for end in outcomes]
            data = tuple(np.concatenate(a) for a in zip(*parts, strict=True))
            weights, error = train(
                weights, data, goal, rng, STEPS * (1 if number < ROUNDS - 1 else 5)
            )
            driver = weights
            took = time.perf_counter() - began
            counts = {end: ends.count(end) for end in dict.fromkeys(ends)}
            print(
                (
                    f"round {number}: {counts}, {len(data[0])} frames,"
                    f" relative error {error:.3f}, {took:.0f} s"
                ),
                flush=True,
            )
    np.savez(options.out, **{k: w.astype(np.float32) for k, w in weights.items()})


if __name__ == "__main__":
    main()
