//! The device: buffers, kernels by name, one queue of dispatches that is sent when something is read.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;

use wgpu::util::DeviceExt;

use crate::Error;

pub use wgpu::Buffer;

/// Threads of a dispatch: 65535 workgroups of 256.
pub const MOST_THREADS: u64 = 65535 * 256;

/// Files of kernels, each compiled with `common.wgsl` in front of it.
macro_rules! shaders {
    ($($name:literal),*) => {
        [$(($name, concat!(include_str!("shaders/common.wgsl"), include_str!(concat!("shaders/", $name, ".wgsl"))))),*]
    };
}
const SHADERS: [(&str, &str); 9] = shaders!(
    "adam",
    "binning",
    "blend",
    "field",
    "harmonics",
    "losses",
    "project",
    "sort",
    "sum"
);

/// The same from a folder, for kernels that are being changed.
fn shader_of(folder: &Path, name: &str) -> String {
    let read = |name: &str| {
        let path = folder.join(format!("{name}.wgsl"));
        std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
    };
    read("common") + &read(name)
}

/// A device with its queue and the kernels compiled so far.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    modules: RefCell<BTreeMap<&'static str, wgpu::ShaderModule>>,
    pipelines: RefCell<BTreeMap<&'static str, wgpu::ComputePipeline>>,
    encoder: RefCell<Option<wgpu::CommandEncoder>>,
    pub name: String,
    /// Bytes that one binding can have.
    pub largest_binding: u64,
}

impl Gpu {
    /// The adapter named by `WGPU_ADAPTER_NAME` (part of its name), otherwise the fastest one.
    pub fn new() -> Result<Self, Error> {
        pollster::block_on(Self::open())
    }

    async fn open() -> Result<Self, Error> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let wanted = std::env::var("WGPU_ADAPTER_NAME").map(|w| w.to_lowercase());
        let adapter = match wanted {
            Ok(wanted) => {
                let all = instance.enumerate_adapters(wgpu::Backends::all()).await;
                let found = all
                    .into_iter()
                    .find(|a| a.get_info().name.to_lowercase().contains(&wanted));
                found.ok_or_else(|| format!("no adapter has {wanted:?} in its name"))?
            }
            Err(_) => instance
                .request_adapter(&wgpu::RequestAdapterOptions {
                    power_preference: wgpu::PowerPreference::HighPerformance,
                    ..Default::default()
                })
                .await
                .map_err(|e| format!("no GPU and no software renderer: {e}"))?,
        };
        let has = adapter.limits();
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
            max_buffer_size: has.max_buffer_size,
            ..Default::default()
        };
        let (device, queue) = adapter
            .request_device(&wgpu::DeviceDescriptor {
                required_limits: limits.clone(),
                ..Default::default()
            })
            .await
            .map_err(|e| format!("{}: {e}", adapter.get_info().name))?;
        Ok(Self {
            device,
            queue,
            modules: RefCell::default(),
            pipelines: RefCell::default(),
            encoder: RefCell::default(),
            name: adapter.get_info().name,
            largest_binding: limits.max_storage_buffer_binding_size,
        })
    }

    fn usage() -> wgpu::BufferUsages {
        wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST
    }

    /// A buffer of `words` zeros of four bytes. An empty one has 16 words, because a binding must hold one element
    /// of any array in the shaders; others have their size, because kernels ask for `arrayLength`.
    pub fn zeros(&self, words: usize) -> Buffer {
        let words = if words == 0 { 16 } else { words };
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: 4 * words as u64,
            usage: Self::usage(),
            mapped_at_creation: false,
        })
    }

    /// A buffer with the words of `data`, `f32` or `u32`.
    pub fn upload<T: bytemuck::Pod>(&self, data: &[T]) -> Buffer {
        if data.is_empty() {
            return self.zeros(0);
        }
        self.device
            .create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: bytemuck::cast_slice(data),
                usage: Self::usage(),
            })
    }

    fn pipeline(&self, kernel: &'static str) -> wgpu::ComputePipeline {
        if let Some(found) = self.pipelines.borrow().get(kernel) {
            return found.clone();
        }
        let (file, entry) = kernel
            .split_once('/')
            .expect("kernels are named FILE/ENTRY");
        let (file, source) = SHADERS
            .iter()
            .find(|(name, _)| *name == file)
            .expect("every file of kernels is in SHADERS");
        let source = match std::env::var("GARAD_WGPU_SHADERS") {
            Ok(folder) => shader_of(Path::new(&folder), file),
            Err(_) => (*source).to_owned(),
        };
        let mut modules = self.modules.borrow_mut();
        let module = modules.entry(file).or_insert_with(|| {
            self.device
                .create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(file),
                    source: wgpu::ShaderSource::Wgsl(source.into()),
                })
        });
        let pipeline = self
            .device
            .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(kernel),
                layout: None,
                module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
        self.pipelines.borrow_mut().insert(kernel, pipeline.clone());
        pipeline
    }

    /// Appends `groups` workgroups of `kernel`, `FILE/ENTRY`, with `buffers` as bindings 0, 1, ...
    pub fn run(&self, kernel: &'static str, buffers: &[&Buffer], groups: [usize; 2]) {
        if groups.contains(&0) {
            return;
        }
        let pipeline = self.pipeline(kernel);
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(kernel),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = self.encoder.borrow_mut();
        let encoder =
            encoder.get_or_insert_with(|| self.device.create_command_encoder(&Default::default()));
        let mut pass = encoder.begin_compute_pass(&Default::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        let [x, y] = groups.map(|n| u32::try_from(n).expect("workgroups fit into u32"));
        pass.dispatch_workgroups(x, y, 1);
    }

    /// `run` with as many workgroups of 256 as `threads` need.
    pub fn run_over(&self, kernel: &'static str, buffers: &[&Buffer], threads: usize) {
        self.run(kernel, buffers, [threads.div_ceil(256), 1]);
    }

    /// Sends what was appended, waits, and returns the first `words` words of a buffer.
    pub fn read<T: bytemuck::Pod>(&self, buffer: &Buffer, words: usize) -> Result<Vec<T>, Error> {
        if words == 0 {
            return Ok(Vec::new());
        }
        let size = 4 * words as u64;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self
            .encoder
            .take()
            .unwrap_or_else(|| self.device.create_command_encoder(&Default::default()));
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size);
        self.queue.submit([encoder.finish()]);
        staging.map_async(wgpu::MapMode::Read, .., |_| {});
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| format!("{}: {e}", self.name))?;
        let view = staging
            .get_mapped_range(..)
            .map_err(|e| format!("{}: {e}", self.name))?;
        Ok(bytemuck::pod_collect_to_vec(&view[..]))
    }
}
