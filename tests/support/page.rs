//! The page for whoever watches a node or a bridge, as curl and Prometheus read it.

use super::wait::eventually;
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::TcpStream;

/// The status line and the body of an answer.
pub fn get(address: &str, path: &str) -> (String, String) {
    get_by(address, address, path)
}

/// The answer to a request with this in the header `host`.
pub fn get_by(host: &str, address: &str, path: &str) -> (String, String) {
    ask(&[&format!("host: {host}")], address, path)
}

/// The answer to a request with these headers, too.
pub fn get_with(headers: &[&str], address: &str, path: &str) -> (String, String) {
    ask(&[&[&*format!("host: {address}")], headers].concat(), address, path)
}

fn ask(headers: &[&str], address: &str, path: &str) -> (String, String) {
    let mut stream = eventually("the page listens", || TcpStream::connect(address).ok());
    let headers: String = headers.iter().map(|header| format!("{header}\r\n")).collect();
    write!(stream, "GET {path} HTTP/1.1\r\n{headers}connection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.lines().next().unwrap().to_owned(), body.to_owned())
}

/// The values of a figure, with its labels.
pub fn values<'a>(metrics: &'a str, name: &str) -> Vec<(&'a str, f64)> {
    let of = |line: &'a str| line.strip_prefix(name).filter(|rest| rest.starts_with([' ', '{']));
    let parted = |rest: &'a str| rest.rsplit_once(' ').map(|(labels, value)| (labels, value.parse().unwrap()));
    metrics.lines().filter_map(of).filter_map(parted).collect()
}

/// The names of all figures, as the documentation has them.
pub fn exposed(metrics: &str) -> BTreeSet<String> {
    let types = metrics.lines().filter_map(|line| line.strip_prefix("# TYPE "));
    types
        .map(|line| match line.split_once(' ').unwrap() {
            (name, "counter") if !name.ends_with("_total") => format!("{name}_total"),
            (name, "info") => format!("{name}_info"),
            (name, _) => name.to_owned(),
        })
        .collect()
}

/// Names as the documentation and the rules of alerts have them.
pub fn named(text: &str) -> BTreeSet<String> {
    let is_part = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    text.split(|c| !is_part(c)).filter(|word| word.starts_with("ledgerd_")).map(str::to_owned).collect()
}

/// The figures of docs/metrics.md: those of a node, and those of a bridge.
pub fn documented() -> (BTreeSet<String>, BTreeSet<String>) {
    let all = named(include_str!("../../docs/metrics.md"));
    all.into_iter().partition(|name| !name.starts_with("ledgerd_bridge_"))
}
