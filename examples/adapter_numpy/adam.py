"""Adam (the book: training.md)."""

import numpy as np

F = np.float32


class Adam:
    def __init__(self, shape, params):
        self.m, self.v, self.t = np.zeros(shape, F), np.zeros(shape, F), 0
        self.b1, self.b2, self.eps = (params[name] for name in ("beta1", "beta2", "eps"))

    def step(self, gradient, rate):
        """What is subtracted from the parameters."""
        self.t += 1
        self.m += F(1 - self.b1) * (gradient - self.m)
        self.v += F(1 - self.b2) * (gradient * gradient - self.v)
        m, v = self.m / F(1 - self.b1**self.t), self.v / F(1 - self.b2**self.t)
        return rate * m / (np.sqrt(v) + F(self.eps))


def stage(case):
    now, gradients, rates, p = case["start"], case["gradients"], case["learning_rates"], case.params
    optimiser, path = Adam(now.shape, p), []
    old, change = len(case["kept"]) if "kept" in case else len(now), p.get("change_after", -1)
    there = np.arange(len(now)) < old
    for t, (gradient, rate) in enumerate(zip(gradients, rates)):
        if t == change:
            # Rows leave; rows come with moments of zero, and with the count of the others.
            there = np.concatenate([case["kept"] > 0, np.ones(len(now) - old, bool)])
        step = optimiser.step(np.where(there, gradient, 0), rate)
        now = np.where(there, now - step, now)
        path.append(np.where(there, now, np.nan))
    return {"path": np.stack(path).astype(F)}
