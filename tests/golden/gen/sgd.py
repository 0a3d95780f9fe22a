"""Golden cases of plain gradient descent, p - sum of rate times gradient so far: 80-bit floats, rounded at the end.

    Needs: numpy (2.4.6). Run: python3 sgd.py
"""

import numpy as np

from case import write_case


def make(name, why, start, gradients, rates):
    """gradients [steps, n]. The case holds the parameters after every step."""
    steps = np.longdouble(rates)[:, None] * np.longdouble(gradients)
    path = np.longdouble(start) - np.cumsum(steps, axis=0)
    write_case("sgd", name, basis="closed-form", why=why, script="gen/sgd.py", seed=121,
               inputs={"start": (start, "1"), "gradients": (gradients, "1"), "learning_rates": (rates, "1")},
               outputs={"path": (path.astype(float), "1", "sgd.path")})


rng = np.random.default_rng(121)
make("by_hand", "two steps of sizes that are exact in binary, one of them with a rate of 0",
     np.array([1.0, -2.0, 0.25]), np.array([[0.5, -4.0, 0.0], [2.0, 1.0, -1.0], [1.0, 1.0, 1.0]]), np.array([0.25, 0.5, 0.0]))
gradients = rng.normal(size=(40, 6)) * np.array([1.0, 1e-6, 1e2, 1e-3, 1.0, 1.0])
gradients[5:, 4] = 0  # no momentum: it stops at once
gradients[:8, 5] = 0
make("sequence", "sizes from 1e-6 to 100, vanishing and late gradients, falling learning rate",
     np.round(rng.normal(size=6), 3), gradients, 0.01 * np.exp(-np.arange(40) / 30))
