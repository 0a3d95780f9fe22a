// The stage `sh` as a port: basis functions up to degree 3, their gradient on the unit sphere, colour by degree; in doubles.
//
//     garad golden check --stage sh --exec 'node ports/node/sh.mjs {case} {out}'
//
// Formulas: docs/book/src/splatting.md (R7) and docs/book/src/backward.md (R19).

import { readCase, writeNpy } from "./garad_golden.mjs";

const FUNCTIONS = 16;
const DEGREES = 4;
const [C0, C1, C2, C3, C4, C5, C6, C7, C8, C9] = [
  0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396, 0.5900435899266435,
  2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277,
];

/** [value, by x, by y, by z] of each function. */
function basis([x, y, z]) {
  const [xx, yy, zz] = [x * x, y * y, z * z];
  return [
    [C0, 0, 0, 0],
    [-C1 * y, 0, -C1, 0],
    [C1 * z, 0, 0, C1],
    [-C1 * x, -C1, 0, 0],
    [C2 * x * y, C2 * y, C2 * x, 0],
    [-C2 * y * z, 0, -C2 * z, -C2 * y],
    [C3 * (2 * zz - xx - yy), -2 * C3 * x, -2 * C3 * y, 4 * C3 * z],
    [-C2 * x * z, -C2 * z, 0, -C2 * x],
    [C4 * (xx - yy), 2 * C4 * x, -2 * C4 * y, 0],
    [-C5 * y * (3 * xx - yy), -6 * C5 * x * y, -3 * C5 * (xx - yy), 0],
    [C6 * x * y * z, C6 * y * z, C6 * x * z, C6 * x * y],
    [-C7 * y * (4 * zz - xx - yy), 2 * C7 * x * y, -C7 * (4 * zz - xx - 3 * yy), -8 * C7 * y * z],
    [C8 * z * (2 * zz - 3 * xx - 3 * yy), -6 * C8 * x * z, -6 * C8 * y * z, 3 * C8 * (2 * zz - xx - yy)],
    [-C7 * x * (4 * zz - xx - yy), -C7 * (4 * zz - 3 * xx - yy), 2 * C7 * x * y, -8 * C7 * x * z],
    [C9 * z * (xx - yy), 2 * C9 * x * z, -2 * C9 * y * z, C9 * (xx - yy)],
    [-C5 * x * (xx - 3 * yy), -3 * C5 * (xx - yy), 6 * C5 * x * y, 0],
  ];
}

function sh(one, out) {
  const directions = one.input("direction").data;
  const { shape: [n, functions], data: coefficients } = one.input("sh");
  if (functions !== FUNCTIONS) throw new Error("expected degree 3");
  const [values, gradients, colors] = [[], [], []];
  for (let i = 0; i < n; i++) {
    const v = [...directions.subarray(3 * i, 3 * i + 3)];
    const length = Math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const d = v.map((c) => c / length);
    const all = basis(d);
    for (const [value, ...gradient] of all) {
      values.push(value);
      const along = gradient[0] * d[0] + gradient[1] * d[1] + gradient[2] * d[2];
      gradients.push(...gradient.map((g, a) => g - along * d[a]));
    }
    for (let degree = 0; degree < DEGREES; degree++) {
      for (let channel = 0; channel < 3; channel++) {
        let sum = 0.5;
        for (let k = 0; k < (degree + 1) ** 2; k++) sum += all[k][0] * coefficients[(FUNCTIONS * i + k) * 3 + channel];
        colors.push(Math.max(sum, 0));
      }
    }
  }
  writeNpy(`${out}/basis.npy`, [n, FUNCTIONS], Float64Array.from(values));
  writeNpy(`${out}/tangent_gradient.npy`, [n, FUNCTIONS, 3], Float64Array.from(gradients));
  writeNpy(`${out}/color.npy`, [n, DEGREES, 3], Float64Array.from(colors));
}

const [folder, out] = process.argv.slice(2);
const one = readCase(folder);
if (one.stage !== "sh") process.exit(77);
sh(one, out);
