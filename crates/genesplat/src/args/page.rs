//! Pages: `train --view`, `view` and `export`; and the paths of cameras, which the live page saves.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use clap::Args;
use genesplat::flags::MORE;
use genesplat::viewer::Address;

use super::SplatArgs;

/// Only this machine reaches it, and any port that is free.
const NEAR: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// A page that shows a run.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct TrainPageArgs {
    /// Show the run in the browser while it trains and after: a page on this machine, whose address is
    /// printed. In a terminal it stays until Ctrl-C; elsewhere as long as somebody looks, so that scripts go
    /// on. While somebody moves the camera, training yields for two seconds at most in a row, else pictures
    /// take at most 5 % of the time while the page is open, and none otherwise
    #[arg(long)]
    view: bool,
    /// Address of the page, with a port or without [default: 127.0.0.1, any port, so that only this machine
    /// reaches it]. Whoever knows the whole address, token included, can look and stop the run
    #[arg(long, value_name = "IP[:PORT]", value_parser = address, requires = "view", help_heading = MORE)]
    view_address: Option<SocketAddr>,
    /// Name of a proxy or tunnel that leads to the page, so that browsers may come by it, with https or
    /// without; may be given more than once [default: none]
    #[arg(long, value_name = "NAME", value_parser = host, requires = "view", help_heading = MORE)]
    view_host: Vec<String>,
}

impl TrainPageArgs {
    /// `None` where no page is wanted.
    pub(crate) fn address(&self) -> Option<Address> {
        self.view.then(|| at(self.view_address, &self.view_host))
    }
}

/// A page that shows a splat.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct PageArgs {
    /// Address of the page, with a port or without [default: 127.0.0.1, any port, so that only this machine
    /// reaches it]
    #[arg(long, value_name = "IP[:PORT]", value_parser = address)]
    view_address: Option<SocketAddr>,
    /// Name of a proxy or tunnel that leads to the page, so that browsers may come by it, with https or
    /// without; may be given more than once [default: none]
    #[arg(long, value_name = "NAME", value_parser = host)]
    view_host: Vec<String>,
}

impl PageArgs {
    pub(crate) fn address(&self) -> Address {
        at(self.view_address, &self.view_host)
    }
}

fn at(socket: Option<SocketAddr>, hosts: &[String]) -> Address {
    Address { socket: socket.unwrap_or(NEAR), hosts: hosts.to_vec() }
}

#[derive(Debug, Args)]
pub(crate) struct ViewArgs {
    /// Folder of the scene, for its photos and cameras [default: that of the RUN, if it is still there; none
    /// for a SPLAT]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) page: PageArgs,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
}

#[derive(Debug, Args)]
pub(crate) struct ExportArgs {
    /// The page to write: one file that any browser shows, from the disk and without a network
    #[arg(long, value_name = "FILE.html")]
    pub(crate) out: PathBuf,
    /// Folder of the scene, for the cameras to jump to: those of photos that training never saw [default:
    /// that of the RUN, if it is still there; none for a SPLAT]
    #[arg(long, value_name = "DATASET")]
    pub(crate) data: Option<PathBuf>,
    /// What the page is called [default: the name of the scene, else of the file]
    #[arg(long, value_name = "TEXT")]
    pub(crate) title: Option<String>,
    #[command(flatten)]
    pub(crate) splat: SplatArgs,
}

/// Where a camera moves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PathChoice {
    Orbit,
    Spiral,
    Interpolate,
    File(PathBuf),
}

impl PathChoice {
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        match text {
            "orbit" => Ok(Self::Orbit),
            "spiral" => Ok(Self::Spiral),
            "interpolate" => Ok(Self::Interpolate),
            file if file.ends_with(".json") => Ok(Self::File(file.into())),
            _ => Err("orbit, spiral, interpolate or the name of a .json is needed".into()),
        }
    }
}

fn address(text: &str) -> Result<SocketAddr, String> {
    let bare = || text.parse::<IpAddr>().map(|address| SocketAddr::new(address, 0));
    text.parse()
        .or_else(|_| bare())
        .map_err(|_| "an address such as 127.0.0.1 or 192.168.1.5:7007 is needed".into())
}

/// A name as browsers send it: no address of a page, and no pattern.
fn host(text: &str) -> Result<String, String> {
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || ['-', '.', '_'].contains(&c);
    let is_name = (1..=253).contains(&text.len()) && text.chars().all(is_of_name) && !text.starts_with('.');
    let name = is_name.then(|| text.to_ascii_lowercase());
    name.ok_or_else(|| {
        "the bare name of a machine is needed, such as splats.example.org, without https:// and port".into()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_is_a_bare_name() {
        assert_eq!(host("Splats.example.org").unwrap(), "splats.example.org");
        for text in
            ["", "*", "*.example.org", "https://x.org", "x.org/", "x.org:80", "a b", ".org", "x\r\nHost: y"]
        {
            assert!(host(text).is_err(), "{text}");
        }
    }

    #[test]
    fn addresses_have_a_port_or_any() {
        assert_eq!(address("127.0.0.1").unwrap(), NEAR);
        assert_eq!(address("[::1]:7007").unwrap(), "[::1]:7007".parse().unwrap());
        assert_eq!(address("0.0.0.0:80").unwrap().port(), 80);
        assert!(address("localhost").is_err() && address("").is_err());
    }
}
