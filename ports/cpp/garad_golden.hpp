// Reads golden cases and writes answers: C++17, this header alone, little-endian machines.
//
//     garad_golden::Case one(folder);                       // case.json, inputs, params
//     std::vector<float> means = one.input("means").as<float>();
//     garad_golden::write<float>(out, "color", {height, width, 3}, color);
//
// The format is in tests/golden/README.md, its schema in tests/golden/case.schema.json. Expected outputs are not read. What
// is wrong with a case is thrown as std::runtime_error, with the file.
#pragma once

#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <locale>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace garad_golden {

[[noreturn]] inline void fail(const std::string& what) { throw std::runtime_error(what); }

inline std::string read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) fail(path + ": cannot be read");
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// A JSON value. Numbers are doubles: whole numbers of a case are at most 2^53.
struct Json {
  enum class Kind { null, boolean, number, string, array, object };
  Kind kind = Kind::null;
  bool boolean = false;
  double number = 0.0;
  std::string string;
  std::vector<Json> array;
  std::map<std::string, Json> object;

  bool has(const std::string& key) const { return object.count(key) != 0; }
  const Json& at(const std::string& key) const {
    const auto found = object.find(key);
    if (found == object.end()) fail("no '" + key + "'");
    return found->second;
  }
};

// Recursive descent; \u escapes of the Basic Multilingual Plane become UTF-8.
class JsonParser {
 public:
  explicit JsonParser(const std::string& text) : text_(text) {}

  Json parse() {
    Json value = this->value();
    if (peek() != '\0') fail(place("expected the end"));
    return value;
  }

 private:
  const std::string& text_;
  std::size_t at_ = 0;

  std::string place(const std::string& what) const { return what + " at byte " + std::to_string(at_); }

  char peek() {
    while (at_ < text_.size() && std::strchr(" \n\t\r", text_[at_]) != nullptr && text_[at_] != '\0') ++at_;
    return at_ < text_.size() ? text_[at_] : '\0';
  }
  bool take(char c) {
    const bool found = peek() == c;
    at_ += found ? 1 : 0;
    return found;
  }
  void expect(char c) {
    if (!take(c)) fail(place(std::string("expected ") + c));
  }
  bool word(const char* w) {
    const bool found = text_.compare(at_, std::strlen(w), w) == 0;
    at_ += found ? std::strlen(w) : 0;
    return found;
  }

  Json value() {
    Json out;
    switch (peek()) {
      case '{':
        out.kind = Json::Kind::object;
        for (++at_; !take('}');) {
          std::string key = text();
          expect(':');
          out.object.emplace(std::move(key), value());
          if (!take(',') && peek() != '}') fail(place("expected , or }"));
        }
        return out;
      case '[':
        out.kind = Json::Kind::array;
        for (++at_; !take(']');) {
          out.array.push_back(value());
          if (!take(',') && peek() != ']') fail(place("expected , or ]"));
        }
        return out;
      case '"':
        out.kind = Json::Kind::string;
        out.string = text();
        return out;
      default:
        break;
    }
    if (word("null")) return out;
    if (word("true") || word("false")) {
      out.kind = Json::Kind::boolean;
      out.boolean = text_[at_ - 2] == 'u';  // tr(u)e
      return out;
    }
    const std::size_t end = text_.find_first_not_of("+-.0123456789eE", at_);
    // The nearest double, whatever the locale says of decimal points.
    std::istringstream digits(text_.substr(at_, end - at_));
    digits.imbue(std::locale::classic());
    out.kind = Json::Kind::number;
    if (!(digits >> out.number)) fail(place("expected a value"));
    at_ = end == std::string::npos ? text_.size() : end;
    return out;
  }

  std::string text() {
    expect('"');
    std::string out;
    while (at_ < text_.size() && text_[at_] != '"') {
      char c = text_[at_++];
      if (c != '\\') {
        out.push_back(c);
        continue;
      }
      c = at_ < text_.size() ? text_[at_++] : '\0';
      if (c == 'u') {
        const auto code = static_cast<unsigned>(std::stoul(text_.substr(at_, 4), nullptr, 16));
        at_ += 4;
        if (code >= 0x800) out.push_back(static_cast<char>(0xE0 | (code >> 12)));
        if (code >= 0x80) out.push_back(static_cast<char>(code >= 0x800 ? 0x80 | ((code >> 6) & 0x3F) : 0xC0 | (code >> 6)));
        out.push_back(static_cast<char>(code >= 0x80 ? 0x80 | (code & 0x3F) : code));
        continue;
      }
      const char* const names = "bfnrt";
      const char* const found = std::strchr(names, c);
      out.push_back(found != nullptr && c != '\0' ? "\b\f\n\r\t"[found - names] : c);
    }
    expect('"');
    return out;
  }
};

// numpy's descriptor of an element type; the type of an answer decides which tolerance it is held to.
template <typename T>
const char* descr() {
  if constexpr (std::is_same_v<T, bool>) return "|b1";
  else if constexpr (std::is_same_v<T, float>) return "<f4";
  else if constexpr (std::is_same_v<T, double>) return "<f8";
  else if constexpr (std::is_same_v<T, std::int8_t>) return "|i1";
  else if constexpr (std::is_same_v<T, std::uint8_t>) return "|u1";
  else if constexpr (std::is_same_v<T, std::int16_t>) return "<i2";
  else if constexpr (std::is_same_v<T, std::uint16_t>) return "<u2";
  else if constexpr (std::is_same_v<T, std::int32_t>) return "<i4";
  else if constexpr (std::is_same_v<T, std::uint32_t>) return "<u4";
  else {
    static_assert(std::is_same_v<T, std::int64_t>, "an element type of golden cases");
    return "<i8";
  }
}

// An array: type, sizes with the slowest index first, elements in C order.
struct Tensor {
  std::string descr;
  std::vector<std::size_t> shape;
  std::string bytes;

  std::size_t size() const {
    std::size_t n = 1;
    for (const std::size_t s : shape) n *= s;
    return n;
  }

  // The elements, converted: as<float>() of an input of f64 is what a GPU gets.
  template <typename T>
  std::vector<T> as() const {
    if (descr == "<f4") return cast<float, T>();
    if (descr == "<f8") return cast<double, T>();
    if (descr == "|i1") return cast<std::int8_t, T>();
    if (descr == "|u1" || descr == "|b1") return cast<std::uint8_t, T>();
    if (descr == "<i2") return cast<std::int16_t, T>();
    if (descr == "<u2") return cast<std::uint16_t, T>();
    if (descr == "<i4") return cast<std::int32_t, T>();
    if (descr == "<u4") return cast<std::uint32_t, T>();
    if (descr == "<i8") return cast<std::int64_t, T>();
    fail("element type '" + descr + "'");
  }

 private:
  template <typename From, typename To>
  std::vector<To> cast() const {
    if (bytes.size() != size() * sizeof(From)) fail("shape and number of bytes disagree");
    std::vector<To> out(size());
    for (std::size_t i = 0; i < out.size(); ++i) {
      From element;
      std::memcpy(&element, bytes.data() + i * sizeof(From), sizeof(From));
      out[i] = static_cast<To>(element);
    }
    return out;
  }
};

// A .npy file: version 1.0, C order, the dict of its header in one line.
inline Tensor read_npy(const std::string& path) {
  const std::string file = read_file(path);
  if (file.compare(0, 8, std::string("\x93NUMPY\x01\x00", 8)) != 0) fail(path + ": no .npy file of version 1.0");
  const auto byte = [&](std::size_t i) { return static_cast<std::size_t>(static_cast<unsigned char>(file.at(i))); };
  const std::size_t length = byte(8) + 256 * byte(9);
  if (file.size() < 10 + length) fail(path + ": ends in its header");
  const std::string header = file.substr(10, length);
  const auto after = [&](const char* key) {
    const std::size_t found = header.find(key);
    if (found == std::string::npos) fail(path + ": no " + key);
    return found + std::strlen(key);
  };
  if (header.compare(after("'fortran_order': "), 5, "False") != 0) fail(path + ": Fortran order; expected C order");
  Tensor out;
  out.descr = header.substr(after("'descr': '"), 3);
  for (std::size_t at = after("'shape': ("); header.at(at) != ')';) {
    if (header[at] == ',' || header[at] == ' ') {
      ++at;
      continue;
    }
    std::size_t used = 0;
    out.shape.push_back(std::stoul(header.substr(at), &used));
    at += used;
  }
  out.bytes = file.substr(10 + length);
  return out;
}

// Inputs and parameters of a case.
class Case {
 public:
  explicit Case(std::string folder) : folder_(std::move(folder)), json_(JsonParser(read_file(folder_ + "/case.json")).parse()) {}

  const std::string& stage() const { return json_.at("stage").string; }
  const std::string& name() const { return json_.at("case").string; }
  const Json& param(const std::string& name) const { return json_.at("params").at(name); }
  double number(const std::string& name) const { return param(name).number; }
  bool has(const std::string& input) const { return json_.at("inputs").has(input); }
  std::vector<std::string> inputs() const {
    std::vector<std::string> names;
    for (const auto& entry : json_.at("inputs").object) names.push_back(entry.first);
    return names;
  }

  Tensor input(const std::string& name) const {
    const Json& entry = json_.at("inputs").at(name);
    if (entry.has("file")) return read_npy(folder_ + "/" + entry.at("file").string);
    Tensor out;
    for (const Json& size : entry.at("shape").array) out.shape.push_back(static_cast<std::size_t>(size.number));
    std::vector<double> flat;
    flatten(entry.at("data"), flat);
    // f32 numbers are written with digits enough, other types are whole: a double holds each.
    out.descr = "<f8";
    out.bytes.assign(reinterpret_cast<const char*>(flat.data()), flat.size() * sizeof(double));
    if (flat.size() != out.size()) fail(folder_ + ": " + name + ": shape and data disagree");
    return out;
  }

 private:
  std::string folder_;
  Json json_;

  static void flatten(const Json& data, std::vector<double>& out) {
    switch (data.kind) {
      case Json::Kind::array:
        for (const Json& item : data.array) flatten(item, out);
        break;
      case Json::Kind::boolean:
        out.push_back(data.boolean ? 1.0 : 0.0);
        break;
      case Json::Kind::string: {  // what JSON has no number for
        const double inf = std::numeric_limits<double>::infinity();
        out.push_back(data.string == "nan" ? std::numeric_limits<double>::quiet_NaN() : data.string == "inf" ? inf : -inf);
        break;
      }
      default:
        out.push_back(data.number);
    }
  }
};

// FOLDER/NAME.npy. bool answers are passed as std::vector<std::uint8_t>: numbers are compared, not types.
template <typename T>
void write(const std::string& folder, const std::string& name, const std::vector<std::size_t>& shape, const std::vector<T>& values) {
  std::size_t n = 1;
  std::string sizes;
  for (const std::size_t size : shape) {
    n *= size;
    sizes += std::to_string(size) + ",";
    if (&size != &shape.back()) sizes += " ";
  }
  if (shape.size() > 1) sizes.pop_back();
  if (n != values.size()) fail(name + ": " + std::to_string(values.size()) + " numbers; its shape has " + std::to_string(n));
  std::string header = std::string("{'descr': '") + descr<T>() + "', 'fortran_order': False, 'shape': (" + sizes + "), }";
  header.append(63 - (10 + header.size()) % 64, ' ').push_back('\n');
  std::ofstream file(folder + "/" + name + ".npy", std::ios::binary);
  const auto length = static_cast<std::uint16_t>(header.size());
  const char preamble[10] = {'\x93', 'N', 'U', 'M', 'P', 'Y', 1, 0, static_cast<char>(length & 255), static_cast<char>(length >> 8)};
  file.write(preamble, sizeof preamble);
  file.write(header.data(), static_cast<std::streamsize>(header.size()));
  file.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(n * sizeof(T)));
  if (!file.flush()) fail(folder + "/" + name + ".npy: cannot be written");
}

}  // namespace garad_golden
