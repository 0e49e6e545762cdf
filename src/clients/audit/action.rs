//! The actions that policies decide about, by the calls that ask for them.

use super::ABAC;

/// The action that a refused call needed, as policies name it. Empty if one call needs several, or somebody else's right.
pub(super) fn of_call(chaincode: &str, function: &str) -> &'static str {
    if chaincode != ABAC {
        return "";
    }
    match function {
        "acquire" | "submit" => "acquire",
        "set" | "share" => "publish",
        "subscribe" | "reader" => "subscribe",
        "take" => "override",
        "confirm" => "confirm",
        "stop" => "stop",
        "resume" => "resume",
        _ => "",
    }
}
