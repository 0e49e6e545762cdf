//! The settings of a configuration file, line by line, for people who compare two of them.

use std::collections::BTreeMap;

/// Each setting by its path, such as `console.listen`, with its text. A section that comes several times is numbered.
fn settings(text: &str) -> BTreeMap<String, String> {
    let (mut found, mut seen) = (BTreeMap::<String, String>::new(), BTreeMap::<String, u32>::new());
    let (mut section, mut last) = (String::new(), None::<String>);
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if line.starts_with('[') && last.as_ref().is_none_or(|last| is_whole(found.get(last))) {
            let name = line.trim_matches(['[', ']']);
            let number = seen.entry(name.to_owned()).or_default();
            *number += 1;
            section = if *number > 1 { format!("{name}.{number}.") } else { format!("{name}.") };
            last = None;
            continue;
        }
        let open = last.as_ref().filter(|last| !is_whole(found.get(*last)));
        match (open.and_then(|open| found.get_mut(open)), line.split_once('=')) {
            // A list over several lines.
            (Some(value), _) => value.push_str(line),
            (None, Some((name, value))) => {
                let path = format!("{section}{}", name.trim());
                found.insert(path.clone(), value.trim().to_owned());
                last = Some(path);
            }
            (None, None) => {}
        }
    }
    found
}

/// Is every list of the value closed?
fn is_whole(value: Option<&String>) -> bool {
    value.is_none_or(|value| value.matches('[').count() <= value.matches(']').count())
}

/// The settings in which two files differ, a line each: what this one has, and the other one.
pub(super) fn differences(here: &str, backup: &str) -> Vec<String> {
    let (here, backup) = (settings(here), settings(backup));
    let shown = |value: Option<&String>| value.map_or("not set", String::as_str).to_owned();
    let mut paths: Vec<_> = here.keys().chain(backup.keys()).collect();
    paths.sort();
    paths.dedup();
    let differ = paths.into_iter().filter(|path| here.get(*path) != backup.get(*path));
    differ
        .map(|path| format!("{path}: {} here, {} in the backup", shown(here.get(path)), shown(backup.get(path))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_differ_are_named_with_both_values() {
        let here =
            "data = \"data\"\nlisten = \"127.0.0.1:7450\"\n# listen = \"x\"\n[console]\nlisten = \"127.0.0.1:1\"\n";
        let backup = "listen = \"0.0.0.0:7450\"\ndata = \"data\"\n[peers]\nallow = [\n  \"*:443\",\n]\n[console]\nname = \"a\"\n";
        assert_eq!(
            differences(here, backup),
            [
                "console.listen: \"127.0.0.1:1\" here, not set in the backup",
                "console.name: not set here, \"a\" in the backup",
                "listen: \"127.0.0.1:7450\" here, \"0.0.0.0:7450\" in the backup",
                "peers.allow: not set here, [\"*:443\",] in the backup",
            ]
        );
        assert!(differences(here, here).is_empty());
    }

    #[test]
    fn sections_that_come_several_times_are_numbered() {
        let routes = "[[bridge.route]]\nservice = \"a\"\n[[bridge.route]]\nservice = \"b\"\n";
        let others = "[[bridge.route]]\nservice = \"a\"\n[[bridge.route]]\nservice = \"c\"\n";
        assert_eq!(differences(routes, others), ["bridge.route.2.service: \"b\" here, \"c\" in the backup"]);
    }
}
