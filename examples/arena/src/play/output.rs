//! The results of the arena: pictures, a page, numbers, and a table on the terminal.

use super::{Options, Played};
use crate::model::claims::{Claim, Runs};
use crate::model::figures::Figures;
use crate::picture::{Facts, Rate, draw, page};
use ledger_base::rejection::{Code, Rejection};
use ledgerd::demo::eprint_line;
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The page.
const PAGE: &str = "index.html";
/// The numbers, as `--json` prints them.
const NUMBERS: &str = "numbers.json";

/// The directory of the results. One that was made and stays empty is removed with it.
pub(crate) struct Results {
    directory: PathBuf,
    is_new: bool,
}

/// The results in words, for the end.
pub(crate) struct Written {
    /// For programs.
    pub json: String,
    /// For people.
    pub table: String,
}

/// The line for programs, and the file of numbers.
#[derive(Serialize)]
struct Line<'a> {
    ok: bool,
    version: &'static str,
    seed: u64,
    scale: f64,
    link: String,
    claims: &'a [Claim],
    runs: &'a Runs<Figures>,
    rates: &'a [Rate],
    reader_refused: &'a str,
    page: String,
}

impl Results {
    /// Makes the directory, so that a wrong one is known before the experiment.
    pub(crate) fn open(directory: &Path) -> Result<Self, Rejection> {
        let is_new = !directory.exists();
        let writable = std::fs::create_dir_all(directory).and_then(|()| tempfile::tempfile_in(directory));
        writable.map_err(|error| cannot_write(directory, &error))?;
        Ok(Self { directory: directory.to_owned(), is_new })
    }

    /// Writes everything.
    pub(crate) fn write(
        &self,
        options: &Options,
        played: &Played,
        figures: &Runs<Figures>,
        claims: &[Claim],
    ) -> Result<Written, Rejection> {
        let pictures = draw(&played.records, &played.rates)
            .map_err(|fault| Rejection::new(Code::Internal, format!("a picture cannot be drawn: {fault}")))?;
        for picture in &pictures {
            self.put(&format!("{}.svg", picture.name), picture.svg.as_bytes())?;
        }
        let link = format!("{:?}", options.link).to_lowercase();
        let command =
            format!("cargo run --release -p arena -- --seed {} --scale {} --link {link}", options.seed, options.scale);
        let facts = Facts {
            command: &command,
            version: env!("CARGO_PKG_VERSION"),
            link: &options.link.described(),
            reader_refused: &played.reader_refused,
        };
        self.put(PAGE, page(&facts, &played.records, figures, claims, &pictures).as_bytes())?;
        let line = Line {
            ok: claims.iter().all(|claim| claim.held),
            version: env!("CARGO_PKG_VERSION"),
            seed: options.seed,
            scale: options.scale,
            link,
            claims,
            runs: figures,
            rates: &played.rates,
            reader_refused: &played.reader_refused,
            page: self.page().display().to_string(),
        };
        let json = serde_json::to_string(&line).map_err(|error| Rejection::new(Code::Internal, error.to_string()))?;
        self.put(NUMBERS, json.as_bytes())?;
        Ok(Written { json, table: self.table(figures, claims, &played.rates) })
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), Rejection> {
        let path = self.directory.join(name);
        std::fs::write(&path, bytes).map_err(|error| cannot_write(&path, &error))
    }

    fn page(&self) -> PathBuf {
        self.directory.join(PAGE)
    }

    /// Opens the page in the browser of this user.
    pub(crate) fn show(&self) {
        let opened = Command::new("xdg-open")
            .arg(self.page())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        if let Err(error) = opened {
            eprint_line(&format!("the page is not opened, xdg-open: {error}; open {} yourself", self.page().display()));
        }
    }

    /// The table for people.
    fn table(&self, figures: &Runs<Figures>, claims: &[Claim], rates: &[Rate]) -> String {
        let mut text = String::from(
            "\n  run          waypoints            time    error    extra yaw   refused   command   pose\n\
             \x20                                           rms m        rad                  ms     ms\n",
        );
        for (name, run) in figures.named() {
            let _infallible = writeln!(
                text,
                "  {name:<12} {:<18} {:>5.1} s   {:>6.3}     {:>6.1}    {:>6}   {:>7.1} {:>6.1}",
                run.order_in_words(),
                run.seconds,
                run.path_error_m.rms,
                run.yaw.extra_rad,
                run.refused(),
                run.latency_ms.p50,
                run.feedback_ms.p50
            );
        }
        text.push_str("\n  latency from ROS 2 to ROS 2 in ms\n");
        for rate in rates {
            let _infallible = writeln!(
                text,
                "  {:>5.0} Hz      p50 {:>7.2}   p99 {:>7.2}   {} of {} received",
                rate.hz, rate.p50_ms, rate.p99_ms, rate.received, rate.published
            );
        }
        text.push('\n');
        for claim in claims {
            let mark = if claim.held { "holds " } else { "BROKEN" };
            let _infallible = writeln!(text, "  {mark}  {}", claim.claim);
        }
        let _infallible = write!(text, "\n  pictures and numbers: {}", self.page().display());
        text
    }
}

impl Drop for Results {
    fn drop(&mut self) {
        if self.is_new {
            // Refused if something was written, and that is meant.
            let _not_empty = std::fs::remove_dir(&self.directory);
        }
    }
}

fn cannot_write(path: &Path, error: &std::io::Error) -> Rejection {
    Rejection::new(Code::BadFile, format!("cannot write {}: {error}", path.display()))
        .wanted("a directory that this user may write")
        .next("choose another one: --out DIR")
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_new_directory_goes_with_a_run_that_leaves_nothing_and_stays_with_its_results() {
        let within = tempfile::tempdir().unwrap();
        let directory = within.path().join("deep/arena");
        drop(Results::open(&directory).unwrap());
        assert!(!directory.exists());
        let output = Results::open(&directory).unwrap();
        output.put(NUMBERS, b"{}").unwrap();
        drop(output);
        assert!(directory.join(NUMBERS).exists());
    }

    #[test]
    fn a_file_in_the_place_of_the_directory_is_refused_before_the_experiment() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let refused = Results::open(file.path()).err().unwrap();
        assert_eq!(refused.code, Code::BadFile);
        assert!(refused.message.contains(&file.path().display().to_string()), "{refused}");
    }
}
