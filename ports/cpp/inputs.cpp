// Writes every input of cases as OUT/INPUT.npy in double: shows that the header reads them all (tests/cli/ports.rs).
//
//     inputs CASE OUT [CASE OUT]...
#include <iostream>

#include "garad_golden.hpp"

int main(int count, char** words) {
  try {
    for (int i = 1; i + 1 < count; i += 2) {
      const garad_golden::Case one(words[i]);
      for (const std::string& name : one.inputs()) {
        const garad_golden::Tensor input = one.input(name);
        garad_golden::write(words[i + 1], name, input.shape, input.as<double>());
      }
    }
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
  return 0;
}
