//! The page: one file with all pictures, the numbers, and the robot's motion to replay. It loads nothing.

use super::Picture;
use crate::model::claims::{Claim, Runs};
use crate::model::figures::Figures;
use crate::model::record::{Driving, Record};
use serde_json::{Value, json};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");
/// Every how many pictures of the cameras the replay has one.
const EVERY: usize = 6;

/// The words of the page beside the pictures.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facts<'a> {
    /// How it was called.
    pub command: &'a str,
    /// The program's version.
    pub version: &'a str,
    /// The link of the delayed run, in words.
    pub link: &'a str,
    /// How somebody was refused who may not read the cameras.
    pub reader_refused: &'a str,
}

/// Writes the page.
pub(crate) fn page(
    facts: &Facts<'_>,
    runs: &Runs<Record>,
    figures: &Runs<Figures>,
    claims: &[Claim],
    pictures: &[Picture],
) -> String {
    let mut text = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width\"><title>ledgerd: the arena</title>\n<style>\n{STYLE}</style></head><body>\n\
         <h1>Who drives the robot</h1>\n<p>Two users, one simulated Turtlebot4 in an arena of 8 m × 9 m. Salma's task is \
         Start, A1, A2, A3; Farhad's is Start, B1, B2, B3, given when A1 is reached. Poses and commands cross real bridges and a real ledger \
         of two organisations. Made by <code>{}</code>, ledgerd {}.</p>\n",
        escaped(facts.command),
        escaped(facts.version)
    );
    text += "<h2>What must hold</h2>\n<table class=\"claims\">\n";
    for claim in claims {
        let (mark, class) = if claim.held { ("holds", "held") } else { ("BROKEN", "broken") };
        let _infallible = writeln!(
            text,
            "<tr class=\"{class}\"><td>{mark}</td><td>{}</td><td>{}</td></tr>",
            escaped(claim.claim),
            escaped(&claim.found)
        );
    }
    text += "</table>\n<h2>Replay</h2>\n<div class=\"replay\"><canvas id=\"arena\" width=\"720\" height=\"810\"></canvas>\
             <p><select id=\"run\"></select> <button id=\"play\">pause</button> \
             <input id=\"time\" type=\"range\" min=\"0\" max=\"1000\" value=\"0\"> <span id=\"clock\"></span></p></div>\n";
    text += "<h2>Numbers</h2>\n";
    text += &numbers(figures);
    let _infallible = writeln!(
        text,
        "<p>The link of the delayed run: {}. A visitor asked for the poses and was refused: <i>{}</i>.</p>",
        escaped(facts.link),
        escaped(facts.reader_refused)
    );
    for picture in pictures {
        // The first lines of an SVG file are for viewers of files.
        let svg = picture.svg.find("<svg").and_then(|at| picture.svg.get(at..)).unwrap_or_default();
        let _infallible = writeln!(text, "<figure>{svg}<figcaption>{}</figcaption></figure>", escaped(picture.caption));
    }
    let data = runs.named().map(|(name, record)| motion(name, record));
    let _infallible =
        write!(text, "<script>\nconst runs = {};\n{SCRIPT}</script>\n</body></html>\n", Value::from(data.to_vec()));
    text
}

/// The table of numbers: a row for each, a column for each run.
fn numbers(figures: &Runs<Figures>) -> String {
    type Cell = fn(&Figures) -> String;
    let rows: [(&str, Cell); 13] = [
        ("waypoints, in the order reached", Figures::order_in_words),
        ("time", |run| format!("{:.1} s", run.seconds)),
        ("way", |run| format!("{:.1} m", run.path_m)),
        ("distance from the active reference, rms / largest", |run| {
            format!("{:.3} / {:.3} m", run.path_error_m.rms, run.path_error_m.max)
        }),
        ("turned / needed for the waypoints", |run| {
            format!("{:.1} / {:.1} rad", run.yaw.turned_rad, run.yaw.needed_rad)
        }),
        ("extra turns", |run| format!("{:.1} rad", run.yaw.extra_rad)),
        ("commands received, of Salma / Farhad", |run| {
            let of = |user: &str| run.commands.received.get(user).copied().unwrap_or_default();
            format!("{} / {}", of("Salma"), of("Farhad"))
        }),
        ("commands received a second", |run| format!("{:.1} Hz", run.commands.received_hz)),
        ("commands refused by the ledger", |run| run.refused().to_string()),
        ("changes of driver, as the robot felt it", |run| run.commands.changes_of_driver.to_string()),
        ("command to robot, median / p99", |run| format!("{:.1} / {:.1} ms", run.latency_ms.p50, run.latency_ms.p99)),
        ("pose to controller, median / p99", |run| {
            format!("{:.1} / {:.1} ms", run.feedback_ms.p50, run.feedback_ms.p99)
        }),
        ("emergency stop at the robot after", |run| {
            let after = run.stop.and_then(|stop| stop.to_robot_ms);
            after.map_or("–".into(), |ms| format!("{ms:.1} ms"))
        }),
    ];
    let mut text = String::from(
        "<table class=\"numbers\"><tr><th></th><th>with access control</th><th>without</th><th>preemption, stop</th><th>delayed link</th></tr>\n",
    );
    for (name, cell) in rows {
        let cells: String =
            figures.named().iter().map(|(_, run)| format!("<td>{}</td>", escaped(&cell(run)))).collect();
        let _infallible = writeln!(text, "<tr><th>{name}</th>{cells}</tr>");
    }
    text + "</table>\n"
}

/// The motion of a run: time, place, yaw, and who may drive.
fn motion(name: &str, record: &Record) -> Value {
    let rounded = |value: f64| (value * 1000.0).round() / 1000.0;
    let frames = record.seen.iter().step_by(EVERY).map(|seen| {
        let turn = record.driving.iter().rev().find(|(from, _)| *from <= seen.at);
        let driver = match turn.map_or(Driving::Nobody, |(_, driving)| *driving) {
            Driving::Nobody => 0,
            Driving::One(user) => user.mark(),
            Driving::Both => 3,
        };
        json!([rounded(seen.at), rounded(seen.pose.at.x), rounded(seen.pose.at.y), rounded(seen.pose.yaw), driver])
    });
    let reached = record.reached.iter().map(|reached| json!([rounded(reached.at), reached.waypoint.name()]));
    let points = |user| record.course.waypoints(user).map(|point| json!([point.x, point.y]));
    let start = record.course.start().at;
    json!({
        "name": name,
        "frames": frames.collect::<Vec<_>>(),
        "reached": reached.collect::<Vec<_>>(),
        "start": [start.x, start.y],
        "a": points(crate::model::course::User::Salma),
        "b": points(crate::model::course::User::Farhad),
    })
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
