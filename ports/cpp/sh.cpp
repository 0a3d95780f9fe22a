// The stage `sh` as a port: basis functions up to degree 3, their gradient on the unit sphere, colour by degree; in float.
//
//     g++ -std=c++17 -O2 -ffp-contract=off ports/cpp/sh.cpp -o sh
//     garad golden check --stage sh --exec './sh {case} {out}'
//
// Formulas: docs/book/src/splatting.md (R7) and docs/book/src/backward.md (R19).
#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>

#include "garad_golden.hpp"

namespace {

constexpr std::size_t kFunctions = 16;
constexpr std::size_t kDegrees = 4;
using Vec = std::array<float, 3>;

struct Value {
  float y;
  Vec gradient;  // by x, y, z
};

std::array<Value, kFunctions> basis(const Vec& d) {
  const float x = d[0], y = d[1], z = d[2];
  const float c0 = 0.28209479177387814f, c1 = 0.4886025119029199f, c2 = 1.0925484305920792f, c3 = 0.31539156525252005f;
  const float c4 = 0.5462742152960396f, c5 = 0.5900435899266435f, c6 = 2.890611442640554f, c7 = 0.4570457994644658f;
  const float c8 = 0.3731763325901154f, c9 = 1.445305721320277f;
  const float xx = x * x, yy = y * y, zz = z * z;
  return {{
      {c0, {0, 0, 0}},
      {-c1 * y, {0, -c1, 0}},
      {c1 * z, {0, 0, c1}},
      {-c1 * x, {-c1, 0, 0}},
      {c2 * x * y, {c2 * y, c2 * x, 0}},
      {-c2 * y * z, {0, -c2 * z, -c2 * y}},
      {c3 * (2 * zz - xx - yy), {-2 * c3 * x, -2 * c3 * y, 4 * c3 * z}},
      {-c2 * x * z, {-c2 * z, 0, -c2 * x}},
      {c4 * (xx - yy), {2 * c4 * x, -2 * c4 * y, 0}},
      {-c5 * y * (3 * xx - yy), {-6 * c5 * x * y, -3 * c5 * (xx - yy), 0}},
      {c6 * x * y * z, {c6 * y * z, c6 * x * z, c6 * x * y}},
      {-c7 * y * (4 * zz - xx - yy), {2 * c7 * x * y, -c7 * (4 * zz - xx - 3 * yy), -8 * c7 * y * z}},
      {c8 * z * (2 * zz - 3 * xx - 3 * yy), {-6 * c8 * x * z, -6 * c8 * y * z, 3 * c8 * (2 * zz - xx - yy)}},
      {-c7 * x * (4 * zz - xx - yy), {-c7 * (4 * zz - 3 * xx - yy), 2 * c7 * x * y, -8 * c7 * x * z}},
      {c9 * z * (xx - yy), {2 * c9 * x * z, -2 * c9 * y * z, c9 * (xx - yy)}},
      {-c5 * x * (xx - 3 * yy), {-3 * c5 * (xx - yy), 6 * c5 * x * y, 0}},
  }};
}

void sh(const garad_golden::Case& one, const std::string& out) {
  const std::vector<float> directions = one.input("direction").as<float>();
  const garad_golden::Tensor input = one.input("sh");
  const std::vector<float> coefficients = input.as<float>();
  const std::size_t n = input.shape.at(0);
  if (input.shape.at(1) != kFunctions) garad_golden::fail("expected degree 3");
  std::vector<float> values, gradients, colors;
  for (std::size_t i = 0; i < n; ++i) {
    Vec d = {directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]};
    const float length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (float& v : d) v /= length;
    const auto functions = basis(d);
    for (const Value& f : functions) {
      values.push_back(f.y);
      const float along = f.gradient[0] * d[0] + f.gradient[1] * d[1] + f.gradient[2] * d[2];
      for (std::size_t a = 0; a < 3; ++a) gradients.push_back(f.gradient[a] - along * d[a]);
    }
    for (std::size_t degree = 0; degree < kDegrees; ++degree) {
      for (std::size_t channel = 0; channel < 3; ++channel) {
        float sum = 0.5f;
        for (std::size_t k = 0; k < (degree + 1) * (degree + 1); ++k) {
          sum += functions[k].y * coefficients[(kFunctions * i + k) * 3 + channel];
        }
        colors.push_back(std::max(sum, 0.0f));
      }
    }
  }
  garad_golden::write(out, "basis", {n, kFunctions}, values);
  garad_golden::write(out, "tangent_gradient", {n, kFunctions, 3}, gradients);
  garad_golden::write(out, "color", {n, kDegrees, 3}, colors);
}

}  // namespace

int main(int count, char** words) {
  if (count != 3) return 2;
  try {
    const garad_golden::Case one(words[1]);
    if (one.stage() != "sh") return 77;  // not this stage
    sh(one, words[2]);
  } catch (const std::exception& error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
  return 0;
}
