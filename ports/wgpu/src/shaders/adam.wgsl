// Adam (O6), one thread per number.

struct Step {
    first_decay: f32,       // 1 - β₁
    second_decay: f32,      // 1 - β₂
    first_bias: f32,        // 1 - β₁ᵗ
    second_bias: f32,       // 1 - β₂ᵗ
    epsilon: f32,
    columns: u32,
}

@group(0) @binding(0) var<storage, read> step: Step;
@group(0) @binding(1) var<storage, read> rates: array<f32>;             // by column
@group(0) @binding(2) var<storage, read> gradient: array<f32>;
@group(0) @binding(3) var<storage, read_write> numbers: array<f32>;
@group(0) @binding(4) var<storage, read_write> first: array<f32>;
@group(0) @binding(5) var<storage, read_write> second: array<f32>;

@compute @workgroup_size(256)
fn update(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= arrayLength(&numbers) {
        return;
    }
    let g = gradient[i];
    let m = first[i] + step.first_decay * (g - first[i]);
    let v = second[i] + step.second_decay * (g * g - second[i]);
    first[i] = m;
    second[i] = v;
    numbers[i] -= rates[i % step.columns] * (m / step.first_bias) / (sqrt(v / step.second_bias) + step.epsilon);
}
