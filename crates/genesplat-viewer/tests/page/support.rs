//! A page with a splat behind it, and clients that behave as they should, or do not.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use genesplat_core::{CloudRenderer, Device, Gaussians, RenderSettings, Rng, Stream};
use genesplat_kernels::cpu::CpuBackend;
use genesplat_viewer::{Download, Keeper, LiveView, SceneViews};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Threads and memory are those of the whole process, so tests with a server take turns.
pub(crate) static TURN: Mutex<()> = Mutex::new(());

/// Many small splats of all colours around the origin, at a distance of 4 from the camera of [`look`].
pub(crate) fn cloud(gaussians: usize) -> Gaussians {
    let mut cloud = Gaussians::zeros(gaussians);
    let rng = Rng::new(1);
    for row in 0..gaussians {
        let draw = rng.at(Stream::Background, row as u32, 0, 0);
        cloud.positions[row] = std::array::from_fn(|axis| 4.0 * draw.uniform(axis) - 2.0);
        cloud.log_scales[row] = [-4.5; 3];
        cloud.opacity_logits[row] = 2.0;
        let colour = rng.at(Stream::Background, row as u32, 1, 0);
        (0..3).for_each(|channel| cloud.sh[row][channel] = 3.0 * colour.uniform(channel) - 1.5);
    }
    cloud
}

/// Makes files that say how many Gaussians there are.
struct TestKeeper;

impl Keeper for TestKeeper {
    fn make(&mut self, download: Download, renderer: &mut CloudRenderer<'_>) -> Result<Vec<u8>, String> {
        let gaussians = renderer.cloud().map_err(|error| error.to_string())?.len();
        match download {
            Download::Splat => Ok(vec![b'x'; 1000 * gaussians]),
            Download::Page => Err("no page today".into()),
        }
    }

    fn save(&mut self, renderer: &mut CloudRenderer<'_>) -> Result<String, String> {
        Ok(format!("{} are saved", renderer.cloud().map_err(|error| error.to_string())?.len()))
    }
}

/// A finished splat that is shown until this is dropped.
pub(crate) struct Show {
    pub(crate) url: String,
    stop: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Show {
    pub(crate) fn open(gaussians: usize) -> Self {
        let (sender, receiver) = mpsc::channel();
        let stop = Arc::new(AtomicBool::new(false));
        let of_thread = stop.clone();
        let thread = thread::spawn(move || {
            let cloud = cloud(gaussians);
            let scene_views = SceneViews::new("test", &[], &[], Some(&cloud));
            let mode_device = Box::new(CpuBackend::new());
            let mut live =
                LiveView::start(SocketAddr::from(([127, 0, 0, 1], 0)), scene_views, false, mode_device)
                    .unwrap();
            let mut backend = CpuBackend::new();
            backend.upload(cloud.into()).unwrap();
            sender.send(live.url()).unwrap();
            let settings = RenderSettings { sh_degree: 0, ..RenderSettings::default() };
            live.begin("test", gaussians, 0);
            let is_over = |_| of_thread.load(Ordering::Relaxed);
            live.serve_until(&mut backend, settings, &mut TestKeeper, is_over);
        });
        Self { url: receiver.recv().unwrap(), stop, thread: Some(thread) }
    }

    /// `127.0.0.1:PORT`.
    pub(crate) fn host(&self) -> &str {
        host(&self.url)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        connect(self.host())
    }

    /// The first line of the answer to a request, and all of it.
    pub(crate) fn answer(&self, request: &str) -> (String, String) {
        let mut stream = self.connect();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        // A server that refuses may close before it has read all.
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer).into_owned();
        (answer.lines().next().unwrap_or_default().to_owned(), answer)
    }

    /// A socket to which nothing was said yet.
    pub(crate) fn socket(&self) -> Option<WebSocket<TcpStream>> {
        socket(&self.url)
    }

    /// A page's socket; `None` where the server has no room.
    pub(crate) fn page(&self) -> Option<WebSocket<TcpStream>> {
        let mut socket = self.socket()?;
        matches!(socket.read(), Ok(Message::Text(hello)) if hello.contains("hello")).then_some(socket)
    }
}

fn host(url: &str) -> &str {
    url.split('/').nth(2).unwrap()
}

fn connect(host: &str) -> TcpStream {
    let stream = TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// The socket of the page at `url`.
pub(crate) fn socket(url: &str) -> Option<WebSocket<TcpStream>> {
    let mut request = format!("ws{}socket", url.strip_prefix("http").unwrap()).into_client_request().unwrap();
    request.headers_mut().insert("origin", format!("http://{}", host(url)).parse().unwrap());
    Some(tungstenite::client(request, connect(host(url))).ok()?.0)
}

impl Drop for Show {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

/// Asks for a picture.
pub(crate) fn look(sequence: u32, width: u32, height: u32, mode: &str) -> Message {
    Message::text(format!(
        r#"{{"type":"look","sequence":{sequence},"pose":{{"position":[0,0,-4],"rotation":[1,0,0,0],"fov_y":1}},
           "width":{width},"height":{height},"quality":90,"render_mode":"{mode}"}}"#
    ))
}

/// The next picture: its header, and its JPEG.
pub(crate) fn picture(socket: &mut WebSocket<TcpStream>) -> (serde_json::Value, Vec<u8>) {
    loop {
        let Message::Binary(bytes) = socket.read().unwrap() else { continue };
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        return (serde_json::from_slice(&bytes[4..4 + length]).unwrap(), bytes[4 + length..].to_vec());
    }
}

/// Threads of this process.
#[cfg(target_os = "linux")]
pub(crate) fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").unwrap().count()
}

/// Memory of this process that is filled, bytes.
#[cfg(target_os = "linux")]
pub(crate) fn resident_bytes() -> u64 {
    of_status("VmRSS")
}

/// Memory of this process, filled or not, bytes.
#[cfg(target_os = "linux")]
pub(crate) fn reserved_bytes() -> u64 {
    of_status("VmSize")
}

#[cfg(target_os = "linux")]
fn of_status(name: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with(name)).unwrap();
    1024 * line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap()
}

/// Waits until `holds`, at most so many seconds; whether it does.
pub(crate) fn comes_true(seconds: u64, mut holds: impl FnMut() -> bool) -> bool {
    let deadline = Instant::now() + Duration::from_secs(seconds);
    while Instant::now() < deadline {
        if holds() {
            return true;
        }
        thread::sleep(Duration::from_millis(20));
    }
    holds()
}
