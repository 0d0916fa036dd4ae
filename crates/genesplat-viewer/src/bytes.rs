//! A stranger's bytes without a connection: where the fuzzer comes in (`fuzz/` in the repository).

use std::net::Ipv4Addr;

use crate::gate::Gate;
use crate::http::{Status, parse_head};

/// What a request asks for, of a page on loopback with this `token`; `None` where more bytes are needed.
///
/// # Errors
/// The status line that is answered.
pub fn request(token: &str, bytes: &[u8]) -> Result<Option<String>, &'static str> {
    let gate = Gate::with_token(token.into(), Ipv4Addr::LOCALHOST.into());
    let Some((request, end)) = parse_head(bytes).map_err(Status::line)? else { return Ok(None) };
    assert!(end <= bytes.len(), "a head ends within its bytes");
    gate.admit(&request).map(|path| Some(path.to_owned())).map_err(Status::line)
}
