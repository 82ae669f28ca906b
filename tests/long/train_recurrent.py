"""Trains `scenarios/policies/recurrent.npz`: a recurrent policy of marker pixels, over randomised
delays, servos, mounts, noise and dropout.

    pip install torch
    python tests/long/train_recurrent.py [--out FILE.npz] [--seed 0] [--minutes 35]

The environments are the batched ones of an ideal camera (`GymServos`); between policy and
environment stands what real robots add, drawn anew for each episode: commands 0 to 5 frames late,
servos with a lag of up to 0.12 s, friction and other gains, a mount up to 8 degrees and a size of
the target up to 20 % from what is taken for true, 0 to 0.7 px of noise, markers that are missed,
targets that move. The teacher knows the true pose at the time when a command will act, the servos
and the target's velocity, which the learner does not; it says in hindsight what each command should
have been. The learner drives (DAgger), after some rounds in which the teacher does, and has to find
out by the picture's answers.

Each episode is a sequence for back-propagation through time. `recurrent.csv` keeps the curve: of
each 20 rounds the loss, the share of runs that end within 0.5 px, and the median error at the end.

References: Ross, Gordon & Bagnell 2011, "A reduction of imitation learning and structured
prediction to no-regret online learning"; Chen, Zhou, Koltun & Kraehenbuehl 2020, "Learning by
cheating", for a teacher that knows more than its learner; Tobin et al. 2017,
doi:10.1109/IROS.2017.8202133, for randomised simulation; Malis, Chaumette & Boudet 1999,
doi:10.1109/70.760345, for the teacher's law.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import gymnasium
import numpy as np
import torch
import vstestbed.env  # noqa: F401 - registers the environments
from scipy.spatial.transform import Rotation
from torch import nn

POLICY = Path(__file__).parents[2] / "scenarios" / "policies" / "recurrent.py"
RATE_HZ, FRAMES, PAST, MOST = 25.0, 150, 6, 10.0
PERIOD = 1 / RATE_HZ
GAIN, SPEED, TURN = 4.5, 2.0, 2.5  # of the teacher: [1/s], and its largest velocities [m/s, rad/s]
LATE, LAG_S, SIZE = 5, 0.12, 0.2  # bounds of what is drawn: frames, seconds, share
MOUNT, NOISE_PX = np.radians(8.0), 0.7
# by how much friction cuts a change of velocity at most [m/s, rad/s], and how soon that is made up
SHORT, MADE_UP_S = (
    6e-3,
    0.15,
)
# commands under this [m/s, rad/s] count by their absolute error, larger ones by their relative one
LEAST = 3e-3
HIDDEN, FEATURES = 96, 24
CAMERA = {"kind": "perspective", "width": 640, "height": 480, "fovy_deg": 64, "rate_hz": RATE_HZ}
NEAR = {
    "nominal": {"xyz": [0, 0, 1.95]},
    "random": {"xyz": [0.3, 0.3, 0.35], "rpy_deg": [30, 30, 180]},
}
FAR = {
    "nominal": {"xyz": [0, 0, 0.9]},
    "random": {"xyz": [0.6, 0.6, 1.3], "rpy_deg": [15, 15, 100]},
}


def environment(n, start):
    """n ideal cameras of 640 x 480 before the square of `ibvs_book`, which start as told."""
    stop = {
        "duration_s": 2 * FRAMES * PERIOD,
        "converged": {"error_px": 1e-6, "hold_s": 100},
        "lost_after_s": 1.0,
        "rest_after_s": 1000,
    }
    law = {"limits": {"speed_mps": MOST, "rate_radps": MOST}}
    detector = {"kind": "oracle", "field_of_view": "limited"}
    overrides = {"camera": CAMERA, "robot.start": start, "detector": detector, "stop": stop} | {
        f"law.{k}": v for k, v in law.items()
    }
    return gymnasium.make_vec(
        "vstestbed/ibvs_book-v0",
        num_envs=n,
        vectorization_mode="vector_entry_point",
        overrides=overrides,
    )


class Robots:
    """What stands between commands and n ideal cameras, drawn for one episode."""

    def __init__(self, rng, n):
        self.late = rng.integers(0, LATE + 1, n)
        self.part = rng.uniform(0, 1, n) * (self.late < LATE)  # of a frame, later still
        self.blend = 1 - np.exp(-PERIOD / np.maximum(rng.uniform(-0.03, LAG_S, n), 1e-3))
        self.gain = np.concatenate(
            [
                rng.uniform(0.8, 1.2, (n, 3)) * rng.uniform(1 - SIZE, 1 + SIZE, (n, 1)),
                rng.uniform(0.8, 1.2, (n, 3)),
            ],
            1,
        )
        turn = Rotation.from_rotvec(rng.uniform(-MOUNT, MOUNT, (n, 3))).as_matrix()
        self.mount = np.zeros((n, 6, 6))
        self.mount[:, :3, :3] = self.mount[:, 3:, 3:] = turn
        self.noise = np.where(
            rng.uniform(size=n) < 0.3, 0.0, np.exp(rng.uniform(np.log(0.02), np.log(NOISE_PX), n))
        )
        self.missed = np.where(rng.uniform(size=n) < 0.5, 0.0, rng.uniform(0, 0.15, n))
        moves = (rng.uniform(size=n) < 0.35)[:, None]
        self.width, self.omega = (
            rng.uniform(0.02, 0.15, (n, 3)) * moves,
            2 * np.pi * rng.uniform(0.05, 0.3, (n, 3)),
        )
        self.phase = rng.uniform(0, 2 * np.pi, (n, 3))
        self.short = rng.uniform(0, SHORT, (n, 6)) * (rng.uniform(size=n) < 0.7)[:, None]
        self.cut, self.wanted, self.velocity = (np.zeros((n, 6)) for _ in range(3))
        self.queue = [np.zeros((n, 6)) for _ in range(LATE + 2)]

    def moved(self, k, T):
        """The target's velocity in frame k as a twist of the camera against it (n, 6), T its pose
        (n, 4, 4).
        """
        speed = self.width * self.omega * np.cos(self.omega * k * PERIOD + self.phase)
        return np.concatenate(
            [np.einsum("nij,nj->ni", T[:, :3, :3], speed), np.zeros_like(speed)], 1
        )

    def answer(self, command):
        """The camera's velocity (n, 6) in the next frame, of commands (n, 6) that act later."""
        self.queue = [command, *self.queue[:-1]]
        rows, queue = np.arange(len(command)), np.stack(self.queue)
        ordered = (1 - self.part)[:, None] * queue[self.late, rows] + self.part[:, None] * queue[
            self.late + 1, rows
        ]
        wanted = np.einsum("nij,nj->ni", self.mount, self.gain * ordered)
        self.cut = np.exp(-PERIOD / MADE_UP_S) * (self.cut + wanted - self.wanted).clip(
            -self.short, self.short
        )
        self.wanted = wanted
        self.velocity = self.velocity + self.blend[:, None] * (wanted - self.cut - self.velocity)
        return self.velocity

    def command_for(self, velocity, before):
        """The command (n, 6) that brings the velocity about, from the one before it: gains, mount,
        part of the lag undone.
        """
        ahead = np.minimum(1 / self.blend - 1, 0.5)[:, None]
        wanted = velocity + ahead * (velocity - before)
        return np.einsum("nji,nj->ni", self.mount, wanted) / self.gain


def teacher(T, goal):
    """The 2.5D law's velocity (n, 6) towards the goal pose, of the square's centre, its depth and
    the rotation; T (n, 4, 4).
    """
    p, there = T[:, :3, 3], goal[:3, 3]
    z = np.maximum(p[:, 2:], 0.05)
    w = Rotation.from_matrix(T[:, :3, :3] @ goal[:3, :3].T).as_rotvec()
    slope = (p[:, :2] / z - there[:2] / there[2], np.log(z / there[2]))
    # of the centre, -1/GAIN of its velocity
    moved = np.concatenate([p[:, :2] / z * slope[1] * z + z * slope[0], slope[1] * z], 1)
    rate = (1 - np.exp(-GAIN * PERIOD)) / PERIOD
    v = np.concatenate([rate * moved - np.cross(rate * w, p), rate * w], 1)
    share = np.minimum(
        SPEED / (np.linalg.norm(v[:, :3], axis=1) + 1e-9),
        TURN / (np.linalg.norm(v[:, 3:], axis=1) + 1e-9),
    )
    return v * np.minimum(share, 1.0)[:, None]


class Network(nn.Module):
    """The network of `Recurrent`, over whole sequences."""

    def __init__(self):
        super().__init__()
        self.phi = nn.Sequential(
            nn.Linear(8, 64),
            nn.Tanh(),
            nn.Linear(64, 64),
            nn.Tanh(),
            nn.Linear(64, FEATURES, bias=False),
        )
        self.memory = nn.GRU(8 + 8 + 8 + 4 + 6, HIDDEN, batch_first=True)
        self.out = nn.Linear(HIDDEN, 6 * (2 * FEATURES + 6 * PAST))
        nn.init.normal_(self.out.weight, std=0.02)
        nn.init.normal_(self.out.bias, std=0.05)

    def forward(self, x, now, before, goal, past, h=None):
        """Commands (n, T, 6) and the memory."""
        memory, h = self.memory(x, h)
        there, d = self.phi(goal), self.phi(now)
        parts = torch.cat([d - there, d - self.phi(before), past], -1)
        M = self.out(memory).unflatten(-1, (6, -1))
        return (M @ parts[..., None])[..., 0], h


def soft(x):
    """As in the policy."""
    return torch.asinh(100.0 * x) / 5.0


def inputs(now, before, goal, seen, past):
    """What the memory is told."""
    return torch.cat([now, soft(now - before), soft(now - goal), seen, soft(past[..., :6])], -1)


def episodes(net, envs, rng, lead):
    """One episode of each environment, driven by the learner, but for the share `lead` of them,
    which the teacher drives. Its sequences: inputs, labels, weights; and the errors at the end
    [px].
    """
    n = sum(env.num_envs for env in envs)
    robots, led = Robots(rng, n), rng.uniform(size=n) < lead
    first = int(rng.integers(2**30))
    looks = [env.reset(seed=first + 10_000 * i) for i, env in enumerate(envs)]
    pose = np.eye(4)
    pose[2, 3] = 1.0
    last, h, alive, past = None, None, np.ones(n, dtype=bool), np.zeros((n, PAST, 6))
    kept, poses, velocities, moved, going = [], [], [], [], []
    for k in range(FRAMES + LATE + 1):
        seen, goal, uv, T, error = (
            np.concatenate(parts)
            for parts in zip(
                *(
                    (o["seen"], o["goal"], o["markers"], i["truth"]["T_camera_target"], i["error"])
                    for o, i in looks
                ),
                strict=True,
            )
        )
        poses.append(T)
        moved.append(robots.moved(k, T))
        velocities.append(robots.velocity)
        going.append(alive.copy())
        centre = goal.mean(axis=1, keepdims=True)
        scale = np.sqrt(((goal - centre) ** 2).mean(axis=(1, 2)))[:, None, None]
        seen = (seen > 0) & (rng.uniform(size=seen.shape) >= robots.missed[:, None])
        if last is None:
            alive &= seen.all(axis=1)
            begun = alive.copy()
        noisy = uv + robots.noise[:, None, None] * rng.standard_normal(uv.shape)
        found = ((noisy - centre) / scale).reshape(n, 8)
        now = found if last is None else np.where(np.repeat(seen, 2, axis=1), found, last)
        before, there = now if last is None else last, ((goal - centre) / scale).reshape(n, 8)
        step = [
            torch.from_numpy(a.astype(np.float32))[:, None]
            for a in (now, before, there, seen, past.reshape(n, -1))
        ]
        with torch.no_grad():
            u, h = net(inputs(*step), step[0], step[1], step[2], step[4], h)
        u = np.where(
            led[:, None],
            teacher(T, pose) + robots.moved(k, T) + 0.1 * rng.standard_normal((n, 6)),
            u[:, 0].numpy(),
        ).clip(-MOST, MOST)
        kept.append(step)
        last, past = now, np.concatenate([u[:, None], past[:, :-1]], 1)
        twist = (robots.answer(u) - robots.moved(k, T)).clip(-MOST, MOST)
        cuts = np.split(twist / MOST, np.cumsum([env.num_envs for env in envs])[:-1])
        steps = [env.step(part) for env, part in zip(envs, cuts, strict=True)]
        alive &= ~np.concatenate([s[2] | s[3] for s in steps])
        looks = [(s[0], s[4]) for s in steps]
    labels, weights = [], []
    rows = np.arange(n)
    T, V, W, A = np.stack(poses), np.stack(velocities), np.stack(moved), np.stack(going)
    for k in range(FRAMES):
        acts = k + robots.late
        labels.append(
            robots.command_for(teacher(T[acts, rows], pose) + W[acts, rows], V[acts, rows])
        )
        weights.append(A[acts, rows])
    columns = [torch.cat(parts, 1)[:, :FRAMES] for parts in zip(*kept, strict=True)]
    still = begun & (robots.width.max(axis=1) == 0) & ~led & (robots.noise < 0.1)
    end = np.where(alive & np.isfinite(error), error, 1e3)[still]
    return (
        columns,
        torch.from_numpy(np.stack(labels, 1).astype(np.float32)),
        torch.from_numpy(np.stack(weights, 1).astype(np.float32)),
        end,
    )


def main():
    """Train, and write weights and curve."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=POLICY.with_suffix(".npz"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=35)
    options = parser.parse_args()
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    rng, began = np.random.default_rng(options.seed), time.perf_counter()
    envs = [environment(160, NEAR), environment(96, FAR)]
    net, kept, rows = Network(), [], []
    adam = torch.optim.Adam(net.parameters(), lr=2e-3)
    number, losses, ends = 0, [], []
    while (spent := (time.perf_counter() - began) / (60 * options.minutes)) < 1:
        lead = max(0.0, 0.9 - number / 100)
        *sequences, end = episodes(net, envs, rng, lead)
        kept = [*kept[-11:], sequences]
        ends.append(end)
        for group in adam.param_groups:
            group["lr"] = (
                2e-3 * min(1.0, number / 20 + 0.05) * (0.5 + 0.5 * np.cos(np.pi * spent)) + 1e-6
            )
        for i in (len(kept) - 1, *rng.integers(len(kept), size=2)):
            (now, before, goal, seen, past), labels, weights = kept[i]
            pick = torch.from_numpy(rng.permutation(len(now))[:128])
            now, before, goal, seen, past, wanted, weight = (
                a[pick] for a in (now, before, goal, seen, past, labels, weights)
            )
            u, _ = net(inputs(now, before, goal, seen, past), now, before, goal, past)
            error = ((u - wanted) ** 2).sum(-1) / (wanted.norm(dim=-1) + LEAST) ** 2
            loss = (weight * torch.log1p(error)).sum() / weight.sum()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(net.parameters(), 1.0)
            adam.step()
            losses.append(loss.item())
        number += 1
        if number % 20 == 0:
            end = np.concatenate(ends[-20:]) if ends else np.zeros(0)
            end = end if len(end) else np.full(1, np.nan)
            rows.append(
                (
                    number,
                    (time.perf_counter() - began) / 60,
                    np.mean(losses[-60:]),
                    np.mean(end < 0.5),
                    np.median(end),
                )
            )
            print(
                "round {}: {:.1f} min, loss {:.4f}, within 0.5 px {:.3f}, median {:.3g} px".format(
                    *rows[-1]
                ),
                flush=True,
            )
            save(net, options.out, rows)
    save(net, options.out, rows)


def save(net, out, rows):
    """Weights as the policy reads them, and the curve."""
    names = {"phi.0": "0", "phi.2": "1", "phi.4": "2"}
    found = {}
    for key, value in net.state_dict().items():
        layer, _, kind = key.rpartition(".")
        if layer in names:
            found[("W" if kind == "weight" else "b") + names[layer]] = value
        elif layer == "memory":
            found[
                {
                    "weight_ih_l0": "wih",
                    "weight_hh_l0": "whh",
                    "bias_ih_l0": "bih",
                    "bias_hh_l0": "bhh",
                }[kind]
            ] = value
        else:
            found["Wm" if kind == "weight" else "bm"] = value
    np.savez_compressed(
        out,
        **{
            k: v.numpy().astype(np.float16 if v.ndim == 2 else np.float32) for k, v in found.items()
        },
    )
    head = "round,minutes,loss,within_half_px,median_px"
    np.savetxt(
        out.with_suffix(".csv"),
        np.array(rows).reshape(-1, 5),
        "%.6g",
        ",",
        header=head,
        comments="",
    )


if __name__ == "__main__":
    main()
