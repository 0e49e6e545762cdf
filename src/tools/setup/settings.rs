//! The configuration file of a node that is set up, and the address that it tells everybody.

use crate::process::config::{Config, is_address};
use ledger_base::durable::PUBLIC_MODE;
use ledger_base::hash::Hash;
use ledger_base::rejection::{Code, Rejection};
use ledger_base::shell;
use std::fs;
use std::net::SocketAddr;
use std::path::Path;

/// The file that is written where no configuration is yet: every setting with its default, commented out.
const SHIPPED_CONFIG: &str = include_str!("../../../ledgerd.toml");
/// The lines in it that say where to listen and where the data are.
const SHIPPED_LISTEN: &str = "#listen = \"127.0.0.1:7450\"";
const SHIPPED_DATA: &str = "#data = \"data\"";
/// Those that say which node it is.
const SHIPPED_MEMBER: [&str; 3] = ["#network = \"\"", "#node = \"\"", "#address = \"\""];

/// The configuration of a node: the file, or what would be written in its place.
pub(crate) struct Settings {
    /// The configuration.
    pub config: Config,
    /// Text to write; none if there is a file.
    text: Option<String>,
}

impl Settings {
    /// Reads the file, if there is one; else takes the shipped configuration, listening at `listen` or where the
    /// address leads, with the data directory `data` or beside the file.
    ///
    /// # Errors
    /// The first fault, with the way to see all; [`Code::BadConfiguration`] if a file says something else than is asked.
    pub(crate) fn of(
        path: &Path,
        address: Option<&str>,
        listen: Option<&str>,
        data: Option<&Path>,
    ) -> Result<Self, Rejection> {
        if fs::symlink_metadata(path).is_ok() {
            let config = Config::load(path).map_err(|faults| first(faults, path))?;
            for (setting, found, asked) in [
                ("listen", config.listen.clone(), listen.map(str::to_owned)),
                ("data", config.data.display().to_string(), data.map(|data| data.display().to_string())),
            ] {
                if let Some(asked) = asked.filter(|asked| *asked != found) {
                    return Err(Rejection::new(
                        Code::BadConfiguration,
                        format!("{} and the command line have different values of {setting}", path.display()),
                    )
                    .found(found)
                    .wanted(asked)
                    .next("change the file, or omit the argument"));
                }
            }
            return Ok(Self { config, text: None });
        }
        let mut text = SHIPPED_CONFIG.to_owned();
        if let Some(listen) = listen.map(str::to_owned).or_else(|| address.and_then(listening)) {
            text = text.replace(SHIPPED_LISTEN, &format!("listen = {listen:?}"));
        }
        if let Some(data) = data {
            let whole =
                std::path::absolute(data).map_err(|error| ledger_base::durable::failed("find", data, &error))?;
            text = text.replace(SHIPPED_DATA, &format!("data = {:?}", whole.to_string_lossy()));
        }
        let config = Config::parse(&text, path).map_err(|faults| first(faults, path))?;
        Ok(Self { config, text: Some(text) })
    }

    /// Lets a file that is to be made say which node of which network it is for. Answers with what to tell the user where the file
    /// was there before and does not say it: what people wrote stays as it is.
    pub(crate) fn name(&mut self, network: Hash, node: &str, address: &str) -> String {
        let network = network.to_string();
        let lines = SHIPPED_MEMBER.into_iter().zip([&network, node, address]);
        let lines = lines.map(|(line, value)| (line, format!("{} = {value:?}", setting(line))));
        match &mut self.text {
            Some(text) => {
                for (line, named) in lines {
                    *text = text.replace(line, &named);
                }
                String::new()
            }
            None if self.config.member.network.is_empty() => {
                let member: String = lines.map(|(_, named)| format!("  {named}\n")).collect();
                format!(
                    "\n{} existed before and is unchanged. Add the node that it is for:\n  [member]\n{member}",
                    self.config.file.display()
                )
            }
            None => String::new(),
        }
    }

    /// Writes the file again that [`Settings::write`] has made.
    ///
    /// # Errors
    /// As that; the file is then as it was.
    pub(crate) fn write_again(&self, path: &Path) -> Result<(), Rejection> {
        let Some(text) = &self.text else { return Ok(()) };
        ledger_base::durable::replace(path, text.as_bytes(), PUBLIC_MODE)
    }

    /// Writes the file if there is none; true if it did.
    ///
    /// # Errors
    /// [`Code::BadFile`] and others if it cannot be written.
    pub(crate) fn write(&self, path: &Path) -> Result<bool, Rejection> {
        let Some(text) = &self.text else { return Ok(false) };
        if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
            fs::create_dir_all(parent)
                .map_err(|error| ledger_base::durable::failed("make directory", parent, &error))?;
        }
        ledger_base::durable::create(path, text.as_bytes(), PUBLIC_MODE).map(|()| true)
    }
}

/// The name of a setting in a line that is commented out.
fn setting(line: &str) -> &str {
    line.trim_start_matches('#').split(' ').next().unwrap_or_default()
}

/// Where to listen so that an address leads here.
fn listening(address: &str) -> Option<String> {
    let (host, port) = address.rsplit_once(':')?;
    Some(match address.parse::<SocketAddr>() {
        Ok(address) if address.ip().is_loopback() => address.to_string(),
        // Linux accepts IPv4 there, too.
        Ok(SocketAddr::V6(_)) => format!("[::]:{port}"),
        Err(_) if host.eq_ignore_ascii_case("localhost") => format!("127.0.0.1:{port}"),
        _ => format!("0.0.0.0:{port}"),
    })
}

fn first(faults: Vec<crate::process::config::Fault>, path: &Path) -> Rejection {
    let more = format!("correct it; ledgerd check --config {} names all {} faults", shell::path(path), faults.len());
    let first = faults.into_iter().next().map(Rejection::from);
    first.map_or_else(|| Rejection::new(Code::BadConfiguration, "the configuration is not usable"), |r| r.next(more))
}

/// The address under which the others know the node: what was given, else where it listens.
///
/// # Errors
/// [`Code::BadConfiguration`] if nobody could reach it there.
pub(crate) fn public_address(given: Option<&str>, listen: &str, command: &str) -> Result<String, Rejection> {
    let unusable = |found: &str, why: &str| {
        Err(Rejection::new(Code::BadConfiguration, format!("other nodes cannot reach this node at {found}"))
            .found(why)
            .wanted("HOST:PORT as clients and other nodes use it")
            .next(format!("{command} --address HOST:PORT")))
    };
    let address = given.unwrap_or(listen);
    if !is_address(address) {
        return unusable(address, "an address that is not HOST:PORT");
    }
    if address.ends_with(":0") {
        return unusable(address, "port 0, for which the system selects a different port at each start");
    }
    if address.parse::<SocketAddr>().is_ok_and(|address| address.ip().is_unspecified()) {
        return unusable(address, "an address that means every interface of this machine");
    }
    Ok(address.to_owned())
}
