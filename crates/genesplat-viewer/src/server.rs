//! The server: one thread that accepts, and one for each connection, of which there are a few at most.

use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use tungstenite::handshake::derive_accept_key;

use crate::ViewerError;
use crate::downloads::{Download, Downloads};
use crate::gate::{Address, Gate};
use crate::http::{Request, Status, attachment_head, read_request, refuse, respond};
use crate::hub::Hub;
use crate::page::part;
use crate::places::{Place, Places};
use crate::scene_views::SceneViews;
use crate::socket::{self, TimedStream};

/// Whoever connects has so long to ask, and as long to take the answer.
const REQUEST_WAIT: Duration = Duration::from_secs(4);
/// How long pages are waited for when the server ends.
const CLOSE_WAIT: Duration = Duration::from_secs(1);
/// A file is sent in pieces of so many bytes, each of which may take as long as a message.
const PIECE: usize = 1 << 16;
/// After a failure to accept, which is most often a lack of files.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// What all threads of a server share.
pub(crate) struct Shared {
    pub(crate) hub: Hub,
    pub(crate) scene_views: SceneViews,
    /// The page has buttons that steer a training run.
    pub(crate) can_train: bool,
    pub(crate) downloads: Downloads,
    gate: Gate,
    places: Arc<Places>,
}

/// Serves until it is dropped.
pub(crate) struct Server {
    pub(crate) shared: Arc<Shared>,
    address: SocketAddr,
    acceptor: Option<thread::JoinHandle<()>>,
}

impl Server {
    pub(crate) fn start(
        Address { socket: address, hosts }: Address,
        scene_views: SceneViews,
        can_train: bool,
    ) -> Result<Self, ViewerError> {
        let listen = |source| ViewerError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(listen)?;
        let address = listener.local_addr().map_err(listen)?;
        let gate = Gate::new(address.ip(), hosts)?;
        let (hub, places) = (Hub::default(), Arc::default());
        let shared =
            Arc::new(Shared { hub, scene_views, can_train, downloads: Downloads::default(), gate, places });
        let of_thread = shared.clone();
        let acceptor = thread::Builder::new()
            .name("viewer".into())
            .spawn(move || accept(&listener, &of_thread))
            .map_err(listen)?;
        Ok(Self { shared, address, acceptor: Some(acceptor) })
    }

    /// Where a browser finds the page, token included.
    pub(crate) fn url(&self) -> String {
        format!(
            "http://{}/{}/",
            SocketAddr::new(outward(self.address.ip()), self.address.port()),
            self.shared.gate.token()
        )
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.hub.close();
        self.shared.downloads.end();
        // Wakes the thread that accepts.
        let _ = TcpStream::connect_timeout(
            &SocketAddr::new(reachable(self.address.ip()), self.address.port()),
            CLOSE_WAIT,
        );
        if let Some(acceptor) = self.acceptor.take() {
            let _ = acceptor.join();
        }
        self.shared.places.wait_until_empty(CLOSE_WAIT);
    }
}

/// An address that connects to one that is listened on.
fn reachable(address: IpAddr) -> IpAddr {
    match address {
        IpAddr::V4(any) if any.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(any) if any.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        address => address,
    }
}

/// The same that other machines reach, too, where one is known: a datagram to an address of documentation
/// would leave from it.
fn outward(address: IpAddr) -> IpAddr {
    let of_route = |from: IpAddr, to: IpAddr| {
        let socket = UdpSocket::bind((from, 0)).ok()?;
        socket.connect((to, 9)).ok()?;
        Some(socket.local_addr().ok()?.ip())
    };
    let v4 = of_route(Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into());
    let own = match address {
        // It is listened to in both.
        IpAddr::V6(any) if any.is_unspecified() => {
            v4.or_else(|| of_route(address, Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into()))
        }
        IpAddr::V4(any) if any.is_unspecified() => v4,
        _ => None,
    };
    own.filter(|own| !own.is_unspecified()).unwrap_or_else(|| reachable(address))
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    while !shared.hub.is_closing() {
        match listener.accept() {
            Ok((stream, _)) => begin(stream, shared),
            Err(_) => thread::sleep(ACCEPT_PAUSE),
        }
    }
}

/// Gives the connection a thread, where there is one left for it.
fn begin(stream: TcpStream, shared: &Arc<Shared>) {
    // Where there are no files for one more, it ends.
    let Ok(place) = shared.places.enter(&stream) else { return };
    let Some(mut place) = place else {
        if let Ok(mut stream) = TimedStream::new(stream, ACCEPT_PAUSE, ACCEPT_PAUSE) {
            let _ = refuse(&mut stream, Status::Busy);
        }
        return;
    };
    let shared = shared.clone();
    // Without a thread the connection ends, and its place is free again.
    let _ = thread::Builder::new().name("viewer page".into()).spawn(move || {
        // Whoever hangs up gets no answer.
        let _ = converse(stream, &shared, &mut place);
    });
}

fn converse(stream: TcpStream, shared: &Shared, place: &mut Place) -> std::io::Result<()> {
    let mut timed = TimedStream::new(stream.try_clone()?, REQUEST_WAIT, 2 * REQUEST_WAIT)?;
    let read = read_request(&mut Hurried { stream: &mut timed, by: Instant::now() + REQUEST_WAIT });
    let (request, rest) = match read {
        Ok(Some(read)) => read,
        Ok(None) => return Ok(()),
        Err(status) => return refuse(&mut timed, status),
    };
    let path = match shared.gate.admit(&request) {
        Ok(path) => path,
        Err(status) => return refuse(&mut timed, status),
    };
    if !place.admit() {
        return refuse(&mut timed, Status::Busy);
    }
    if path == "socket" {
        let Some(answer) = upgrade(&request) else { return refuse(&mut timed, Status::BadRequest) };
        timed.write_all(answer.as_bytes())?;
        socket::serve(stream, rest, &shared.hub, &shared.scene_views, shared.can_train);
        return Ok(());
    }
    if let Some((kind, content)) = part(path) {
        return respond(&mut timed, kind, content.as_bytes());
    }
    if let Some(download) = Download::named(path) {
        return match shared.downloads.ask(download) {
            Ok(parcel) => send(&mut timed, parcel.bytes()),
            Err(status) => refuse_late(&mut timed, status),
        };
    }
    match picture(path, &shared.scene_views) {
        Some(jpeg) => respond(&mut timed, "image/jpeg", &jpeg),
        None => refuse(&mut timed, Status::NotFound),
    }
}

/// A file of any size, as long as it is taken.
fn send(stream: &mut TimedStream, file: &[u8]) -> std::io::Result<()> {
    stream.allow_writes();
    stream.write_all(attachment_head(file.len()).as_bytes())?;
    for piece in file.chunks(PIECE) {
        stream.allow_writes();
        stream.write_all(piece)?;
    }
    stream.flush()
}

/// After a wait that was ours.
fn refuse_late(stream: &mut TimedStream, status: Status) -> std::io::Result<()> {
    stream.allow_writes();
    refuse(stream, status)
}

/// A request must be whole by a deadline, not just each of its pieces.
struct Hurried<'a> {
    stream: &'a mut TimedStream,
    by: Instant,
}

impl std::io::Read for Hurried<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if Instant::now() >= self.by {
            Err(std::io::ErrorKind::TimedOut.into())
        } else {
            self.stream.read(buffer)
        }
    }
}

/// `thumbnail/3` and `photo/3`.
fn picture(path: &str, scene_views: &SceneViews) -> Option<Vec<u8>> {
    let (kind, index) = path.split_once('/')?;
    let index = index.parse().ok()?;
    match kind {
        "thumbnail" => scene_views.thumbnail_jpeg(index),
        "photo" => scene_views.photo_jpeg(index),
        _ => None,
    }
}

/// The answer that makes a connection a WebSocket (RFC 6455, section 4.2.2).
fn upgrade(request: &Request) -> Option<String> {
    let is_ours = request.is_upgrade() && request.header("sec-websocket-version") == Some("13");
    let key = request.header("sec-websocket-key").filter(|_| is_ours)?;
    Some(format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {}\r\n\r\n",
        derive_accept_key(key.as_bytes())
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_is_shown_is_one_to_connect_to() {
        for address in ["127.0.0.1", "192.168.1.5", "::1"] {
            let address: IpAddr = address.parse().unwrap();
            assert_eq!(outward(address), address);
        }
        let listener = TcpListener::bind((Ipv4Addr::UNSPECIFIED, 0)).unwrap();
        let own = outward(Ipv4Addr::UNSPECIFIED.into());
        assert!(TcpStream::connect((own, listener.local_addr().unwrap().port())).is_ok(), "{own}");
        // A machine without a network has no address but its own.
        let has_route =
            UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).unwrap().connect(("192.0.2.1", 9)).is_ok();
        assert_ne!(own.is_loopback(), has_route);
    }
}
