// Writes every input of cases as OUT/INPUT.npy in doubles: shows that the module reads them all (tests/cli/ports.rs).
//
//     node inputs.mjs CASE OUT [CASE OUT]...

import { readCase, writeNpy } from "./garad_golden.mjs";

const words = process.argv.slice(2);
for (let i = 0; i + 1 < words.length; i += 2) {
  const one = readCase(words[i]);
  for (const name of one.inputs) {
    const { shape, data } = one.input(name);
    writeNpy(`${words[i + 1]}/${name}.npy`, shape, Float64Array.from(data, Number));
  }
}
