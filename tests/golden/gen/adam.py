"""Golden cases of Adam in closed form: the moments after t steps are sums over all gradients so far,

    m_t = (1 - b1) sum_k b1^(t-k) g_k,    v_t = (1 - b2) sum_k b2^(t-k) g_k^2,

so there is no recurrence to copy. 80-bit floats, rounded at the end.

    Needs: numpy (2.4.6). Run: python3 adam.py
"""

import numpy as np
from case import write_case

B1, B2, EPS = np.longdouble(0.9), np.longdouble(0.999), np.longdouble(1e-15)


def steps(gradients, rates, eps=EPS):
    """The steps of one number at t = 1, 2, ...; rates are learning rates."""
    g = np.asarray(gradients, np.longdouble)
    out = []
    for t in range(1, len(g) + 1):
        age = np.arange(t - 1, -1, -1, dtype=np.longdouble)
        m = (1 - B1) * (B1**age * g[:t]).sum() / (1 - B1 ** np.longdouble(t))
        v = (1 - B2) * (B2**age * g[:t] ** 2).sum() / (1 - B2 ** np.longdouble(t))
        out.append(np.longdouble(rates[t - 1]) * m / (np.sqrt(v) + eps))
    return np.array(out)


def case(name, why, start, gradients, rates, eps=EPS, **params):
    """gradients [steps, n]. The case holds the parameters after every step."""
    path = np.stack([np.longdouble(s) - np.cumsum(steps(g, rates, eps)) for s, g in zip(start, gradients.T)], 1)
    return dict(name=name, why=why, path=path.astype(np.float64), start=start, gradients=gradients, rates=rates, params={"eps": float(eps), **params})


def save(c, **extra):
    write_case("adam", c["name"], basis="closed-form", why=c["why"], script="gen/adam.py", seed=29,
               params={"beta1": float(B1), "beta2": float(B2), "eps": c["params"].pop("eps"), "width": 1, **c["params"]},
               inputs={"start": (c["start"], "1"), "gradients": (c["gradients"], "1"), "learning_rates": (c["rates"], "1"), **extra},
               outputs={"path": (c["path"], "1", "adam.path")})


def main():
    rng = np.random.default_rng(29)
    n = 40
    scale = np.array([1.0, 1e-6, 1e6, 1e-3, 1.0, 1.0])
    gradients = rng.normal(size=(n, 6)) * scale
    gradients[:, 3] = 2e-3                      # the same every time: steps of the learning rate
    gradients[5:, 4] = 0                        # none any more: momentum dies away
    gradients[:8, 5] = 0                        # none at first
    rates = 0.01 * np.exp(-np.arange(n) / 30)
    save(case("sequence", "sizes from 1e-6 to 1e6, constant, vanishing and late gradients, falling learning rate",
               rng.normal(size=6), gradients, rates))

    # With 1e-15 nobody sees where eps stands; beside gradients of its own size everybody does.
    other = np.random.default_rng(31)
    gradients = other.normal(size=(12, 4)) * np.array([1e-3, 1e-2, 1e-4, 1e-6])
    save(case("large_eps", "eps as large as the gradients: inside the root, or scaled by the correction, it gives other steps",
              np.round(other.normal(size=4), 3), gradients, np.full(12, 0.05), eps=np.longdouble(1e-3)))

    # Rows 1 and 3 leave after ten steps, two come: a new row is one whose gradients were 0 so far.
    gradients = rng.normal(size=(25, 7))
    gradients[10:, [1, 3]] = 0
    gradients[:10, 5:] = 0
    start = np.round(rng.normal(size=7), 3)
    c = case("rows", "rows 1 and 3 removed and two appended after ten steps", start, gradients, np.full(25, 0.02), change_after=10)
    c["path"][10:, [1, 3]] = np.nan             # gone
    c["path"][:10, 5:] = np.nan                 # not there yet
    save(c, kept=(np.array([1, 0, 1, 0, 1], np.uint8), "1 stays"))


if __name__ == "__main__":
    main()
