//! Opens the Vulkan device, and turns its failures into errors.

use crate::error::PreviewError;
use parking_lot::Mutex;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, LazyLock, mpsc};
use std::time::{Duration, Instant};

/// Time limit for one submission. A software driver on a busy machine takes seconds for large tiles.
const PATIENCE: Duration = Duration::from_secs(120);

/// Vulkan, opened once for the process and never closed: drivers keep data of threads, and one that is
/// unloaded while threads end may hang.
static VULKAN: LazyLock<wgpu::Instance> = LazyLock::new(|| {
    wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::VULKAN,
        flags: wgpu::InstanceFlags::empty(),
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    })
});

/// An open device with its queue, and the first failure that it reported asynchronously.
pub(crate) struct Device {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    /// Name, kind and driver of the adapter, for messages.
    pub name: String,
    /// Whether it is hardware, not a driver that renders on the processor.
    pub is_hardware: bool,
    fault: Arc<Mutex<Option<String>>>,
}

impl Device {
    /// Opens the best usable adapter: discrete, integrated, then virtual GPUs, software renderers last.
    pub fn open() -> Result<Self, PreviewError> {
        let mut adapters = pollster::block_on(VULKAN.enumerate_adapters(wgpu::Backends::VULKAN));
        adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Other => 3,
            wgpu::DeviceType::Cpu => 4,
        });
        let mut reasons = Vec::new();
        for adapter in &adapters {
            match Self::open_adapter(adapter) {
                Ok(device) => return Ok(device),
                Err(reason) => reasons.push(format!("{}: {reason}", adapter.get_info().name)),
            }
        }
        if reasons.is_empty() {
            reasons.push("no Vulkan adapter found".into());
        }
        Err(PreviewError::NoDevice(reasons.join("; ")))
    }

    fn open_adapter(adapter: &wgpu::Adapter) -> Result<Self, String> {
        if !adapter.features().contains(wgpu::Features::PRIMITIVE_INDEX) {
            return Err("it does not support PRIMITIVE_INDEX".into());
        }
        // Defaults, which every device supports, except for the scene's buffers, which may be as large as
        // allowed.
        let offered = adapter.limits();
        let limits = wgpu::Limits {
            max_buffer_size: offered.max_buffer_size,
            max_storage_buffer_binding_size: offered.max_storage_buffer_binding_size,
            ..wgpu::Limits::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("preview"),
            required_features: wgpu::Features::PRIMITIVE_INDEX,
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        }))
        .map_err(|error| error.to_string())?;
        let fault = Arc::new(Mutex::new(None));
        let note = |fault: &Arc<Mutex<Option<String>>>, message: String| {
            fault.lock().get_or_insert(message);
        };
        let uncaptured = Arc::clone(&fault);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&uncaptured, error.to_string())));
        let lost = Arc::clone(&fault);
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&lost, format!("lost: {message}"));
            }
        });
        let info = adapter.get_info();
        Ok(Self {
            device,
            queue,
            name: format!("{} ({:?}, {})", info.name, info.device_type, info.driver),
            is_hardware: info.device_type != wgpu::DeviceType::Cpu,
            fault,
        })
    }

    /// Largest size of a buffer that shaders read, in bytes.
    pub fn most_bytes(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
    }

    /// A buffer filled with zeros.
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Submits `commands`, waits, and passes `buffer` to `read`. Adds nanoseconds waited to `waited`.
    pub fn run_and_read<T>(
        &self,
        commands: wgpu::CommandBuffer,
        buffer: &wgpu::Buffer,
        bytes: u64,
        waited: &mut u64,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T, PreviewError> {
        let start = Instant::now();
        let submission = self.queue.submit([commands]);
        let (mapped, outcome) = mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, ..bytes, move |result| {
            // The receiver is only gone if the wait has failed.
            let _ = mapped.send(result);
        });
        self.wait(submission)?;
        *waited += start.elapsed().as_nanos() as u64;
        outcome
            .try_recv()
            .map_err(|_| self.failure("the result was not delivered"))?
            .map_err(|error| self.failure(&error.to_string()))?;
        let value = {
            let view = buffer.get_mapped_range(..bytes).map_err(|error| self.failure(&error.to_string()))?;
            read(&view)
        };
        buffer.unmap();
        self.healthy()?;
        Ok(value)
    }

    fn wait(&self, submission: wgpu::SubmissionIndex) -> Result<(), PreviewError> {
        let poll = wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(PATIENCE) };
        // wgpu panics if the device is lost while it waits. That must not end the process.
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(poll))) {
            Ok(Ok(_)) => self.healthy(),
            Ok(Err(wgpu::PollError::Timeout)) => Err(PreviewError::Timeout { seconds: PATIENCE.as_secs() }),
            Ok(Err(error)) => Err(self.failure(&error.to_string())),
            Err(_) => Err(self.failure("lost while waiting for it")),
        }
    }

    /// Returns the failure that the device reported asynchronously, if there was one.
    pub fn healthy(&self) -> Result<(), PreviewError> {
        match &*self.fault.lock() {
            Some(message) => Err(PreviewError::Device(message.clone())),
            None => Ok(()),
        }
    }

    fn failure(&self, otherwise: &str) -> PreviewError {
        self.healthy().err().unwrap_or_else(|| PreviewError::Device(otherwise.into()))
    }
}
