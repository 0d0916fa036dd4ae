//! One page's WebSocket: a thread that reads what the page wants, and sends the newest pictures and texts.

use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error, Message, Utf8Bytes, WebSocket};

use crate::hub::{Hub, Outgoing, Picture};
use crate::message::{ClientMessage, MESSAGE_BYTES_MAX, notice};
use crate::picture::encode_jpeg;
use crate::scene_views::SceneViews;

/// How long a read waits before it is looked whether there is something to send.
const READ_WAIT: Duration = Duration::from_millis(4);
/// A page that has not taken a message after so long is dropped.
const WRITE_WAIT: Duration = Duration::from_secs(5);
/// A page that says nothing is asked whether it is there ...
const PING_EVERY: Duration = Duration::from_secs(20);
/// ... and dropped if it does not answer.
const SILENCE_MAX: Duration = Duration::from_secs(60);
/// A page that sends more messages than this that are none of ours is dropped.
const GARBAGE_MAX: u32 = 16;
/// A page that finds no room has so long to hear it.
const GOODBYE_WAIT: Duration = Duration::from_secs(1);
/// What it hears.
const NO_ROOM: &str = "Too many pages are open; close one.";
/// More than the largest picture of noise takes.
const WRITE_BUFFER_MAX: usize = 64 << 20;

/// A stream whose writes end by a deadline, however slowly the other side takes them.
pub(crate) struct TimedStream {
    stream: TcpStream,
    write_by: Instant,
}

impl TimedStream {
    /// Whoever is on the other side has so long to be read from and written to.
    pub(crate) fn new(stream: TcpStream, read_wait: Duration, write_wait: Duration) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(read_wait))?;
        Ok(Self { stream, write_by: Instant::now() + write_wait })
    }

    /// Whoever takes something has time for more.
    pub(crate) fn allow_writes(&mut self) {
        self.write_by = Instant::now() + WRITE_WAIT;
    }
}

impl Read for TimedStream {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.stream.read(buffer)
    }
}

impl Write for TimedStream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let left = self.write_by.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        self.stream.set_write_timeout(Some(left))?;
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

/// Tells the page what it should know until either side ends it. `rest` are bytes that came after the
/// handshake.
pub(crate) fn serve(stream: TcpStream, rest: Vec<u8>, hub: &Hub, scene_views: &SceneViews, can_train: bool) {
    let Ok(stream) = TimedStream::new(stream, READ_WAIT, WRITE_WAIT) else { return };
    let config = WebSocketConfig::default()
        .read_buffer_size(4096)
        .write_buffer_size(0)
        .max_write_buffer_size(WRITE_BUFFER_MAX)
        .max_message_size(Some(MESSAGE_BYTES_MAX))
        .max_frame_size(Some(MESSAGE_BYTES_MAX));
    let mut socket = WebSocket::from_partially_read(stream, rest, Role::Server, Some(config));
    // A page that is gone is no error.
    let _ = match hub.enter() {
        Some(id) => {
            let _leave = Leave { hub, id };
            let mut page =
                Page { socket, hub, id, garbage: 0, heard: Instant::now(), pinged: Instant::now() };
            page.run(scene_views.hello(can_train))
        }
        None => turn_away(&mut socket, hub),
    };
}

/// Says that there is no room.
fn turn_away(socket: &mut WebSocket<TimedStream>, hub: &Hub) -> Result<(), Error> {
    if !hub.is_closing() {
        socket.send(Message::text(notice(NO_ROOM)))?;
    }
    socket.close(None)?;
    socket.flush()?;
    // Where a connection ends with bytes that nobody has read, the other side may lose what it was told.
    let until = Instant::now() + GOODBYE_WAIT;
    while Instant::now() < until {
        match socket.read() {
            Err(Error::Io(error)) if is_timeout(&error) => {}
            other => drop(other?),
        }
    }
    Ok(())
}

fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

/// Frees the page's place, whatever ends its thread.
struct Leave<'a> {
    hub: &'a Hub,
    id: u64,
}

impl Drop for Leave<'_> {
    fn drop(&mut self) {
        self.hub.leave(self.id);
    }
}

struct Page<'a> {
    socket: WebSocket<TimedStream>,
    hub: &'a Hub,
    id: u64,
    garbage: u32,
    heard: Instant,
    pinged: Instant,
}

impl Page<'_> {
    fn run(&mut self, hello: String) -> Result<(), Error> {
        self.send(Message::text(hello))?;
        loop {
            self.read()?;
            let Outgoing { texts, pictures, is_last } = self.hub.collect(self.id);
            for text in texts {
                self.send(Message::Text(Utf8Bytes::from(&*text)))?;
            }
            for picture in pictures {
                let bytes = self.encode(&picture);
                self.send(Message::binary(bytes))?;
            }
            if is_last {
                self.socket.get_mut().allow_writes();
                self.socket.close(None)?;
                return self.socket.flush();
            }
            self.keep_alive()?;
        }
    }

    /// Takes one message, if there is one.
    fn read(&mut self) -> Result<(), Error> {
        // The answer to a ping is written within.
        self.socket.get_mut().allow_writes();
        let message = match self.socket.read() {
            Err(Error::Io(error)) if is_timeout(&error) => return Ok(()),
            other => other?,
        };
        self.heard = Instant::now();
        match &message {
            Message::Text(text) => self.hear(text.as_bytes()),
            Message::Binary(_) | Message::Frame(_) => self.count_garbage(),
            Message::Ping(_) | Message::Pong(_) => Ok(()),
            Message::Close(_) => Err(Error::ConnectionClosed),
        }
    }

    fn hear(&mut self, bytes: &[u8]) -> Result<(), Error> {
        match ClientMessage::parse(bytes) {
            Ok(message) => {
                self.hub.hear(self.id, message);
                Ok(())
            }
            Err(_) => self.count_garbage(),
        }
    }

    fn count_garbage(&mut self) -> Result<(), Error> {
        self.garbage += 1;
        if self.garbage > GARBAGE_MAX { Err(Error::ConnectionClosed) } else { Ok(()) }
    }

    /// The header's length, the header, the JPEG.
    fn encode(&self, picture: &Picture) -> Vec<u8> {
        let began = Instant::now();
        let header = serde_json::to_vec(&picture.header).expect("plain data with text keys is always JSON");
        let length = (header.len() as u32).to_le_bytes();
        let bytes = [&length[..], &header, &encode_jpeg(&picture.photo, picture.quality)].concat();
        self.hub.add_encoding(began.elapsed());
        bytes
    }

    fn send(&mut self, message: Message) -> Result<(), Error> {
        self.socket.get_mut().allow_writes();
        self.socket.send(message)
    }

    fn keep_alive(&mut self) -> Result<(), Error> {
        if self.heard.elapsed() > SILENCE_MAX {
            return Err(Error::ConnectionClosed);
        }
        if self.heard.elapsed() > PING_EVERY && self.pinged.elapsed() > PING_EVERY {
            self.pinged = Instant::now();
            self.send(Message::Ping(Vec::new().into()))?;
        }
        Ok(())
    }
}
