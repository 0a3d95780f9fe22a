#!/usr/bin/env bash
# The port to a GPU, ports/wgpu: lints, build, and the golden cases of its stages on the Vulkan device there is, or on
# Mesa's renderer for the CPU. Skipped, with a message, where there is no Vulkan driver and none can be installed.
set -euo pipefail
cd "$(dirname "$0")/.."

port=ports/wgpu
garad=target/release/garad
out=$port/target/ci-answers
export CARGO_TERM_COLOR=never

# `grep -q` would end before ldconfig does, which `pipefail` takes for a failure.
has_vulkan() {
    ldconfig -p | grep 'libvulkan\.so\.1' >/dev/null &&
        { [ -n "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ] || compgen -G '/usr/share/vulkan/icd.d/*.json' || compgen -G '/etc/vulkan/icd.d/*.json'; } >/dev/null
}
if ! has_vulkan; then
    [ "$(id -u)" = 0 ] && root=() || root=(sudo -n)
    { "${root[@]}" apt-get update && "${root[@]}" apt-get install -y --no-install-recommends mesa-vulkan-drivers; } >/dev/null 2>&1 || true
fi
if ! has_vulkan; then
    echo "skipped: no Vulkan driver, and apt-get cannot install mesa-vulkan-drivers; the port was neither built nor judged"
    exit 0
fi

[ -x "$garad" ] || cargo build --release
export CARGO_TARGET_DIR=$port/target
# In the release profile, so that macros and build scripts are built once.
cargo clippy --release --manifest-path "$port/Cargo.toml" -- -D warnings
cargo build --release --manifest-path "$port/Cargo.toml"
program=$CARGO_TARGET_DIR/release/garad-wgpu
echo "device: $("$program" device)"

# Every case must pass: none may be unsupported.
judge() {
    "$garad" golden check "$@" | tee "$out.txt"
    if grep -q unsupported "$out.txt"; then
        echo "a stage of the port says that it is not ported"
        return 1
    fi
}
stages=(sh projection_covariance raster raster_backward losses adam train_step mean_field)
judge --exec "$program {case} {out}" "${stages[@]/#/--stage=}"

# Larger ones, made with garad's own values; one process for all.
rm -rf "$out"
"$garad" golden make --scene room --gaussians 20000 --size 320x240 -o "$out/made"
"$garad" golden make --stage mean_field --stage losses --stage adam --stage train_step -o "$out/made"
judge --cases "$out/made" --exec-batch "$program list {list}"

# The same bits on every run; with lavapipe, for one and three threads.
for threads in 1 3; do
    LP_NUM_THREADS=$threads "$program" tests/golden/train_step/two_views "$out/$threads"
done
diff -r "$out/1" "$out/3"

if command -v python3 >/dev/null; then
    python3 "$port/faults.py" "$garad" "$program"
else
    echo "skipped: without python3 no mistakes are put into the kernels"
fi
