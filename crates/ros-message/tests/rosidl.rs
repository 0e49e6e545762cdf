//! The judge of definitions is rosidl: what it makes of texts of ours stands in `rosidl/verdicts.jsonl`. It was written by
//! `rosidl/verdicts.py` with `ros-jazzy-rosidl-adapter`, `-parser` and `-generator-type-description` 4.6.6 of PyPI.
#![expect(clippy::indexing_slicing, clippy::unwrap_used, reason = "tests")]

use ros_message::{ByteOrder, Library, Message, Time, Written};
use serde_json::Value;

/// The type that every text defines.
const NAME: &str = "test_msgs/msg/Test";

struct Verdict {
    text: String,
    line: Value,
}

impl Verdict {
    fn all() -> Vec<Self> {
        let lines = include_str!("rosidl/verdicts.jsonl").lines().map(|line| serde_json::from_str(line).unwrap());
        lines.map(|line: Value| Self { text: line["text"].as_str().unwrap().to_owned(), line }).collect()
    }

    /// The adapter reads the text, and later steps of rosidl have a type for each of its fields.
    fn is_valid(&self) -> bool {
        // Two types of ROS 1 are names to the adapter, and nothing to what follows it.
        let is_of_ros_1 = ["time", "duration"].iter().any(|name| self.text.starts_with(name));
        self.line["adapter"] == true && !is_of_ros_1
    }
}

/// The type that a text defines. Types that it does not define have one field.
fn read(text: &str) -> Result<Message, ros_message::Fault> {
    let mut library = Library::default();
    library.add(NAME, text)?;
    loop {
        match library.message(NAME) {
            Err(fault) if fault.message.ends_with("is not known") => {
                let missing = fault.message.split(' ').find(|word| word.contains('/')).unwrap();
                library.add(missing, "int32 x\n")?;
            }
            done => return done,
        }
    }
}

/// The defaults of a type, by its fields.
fn defaults(message: &Message) -> Value {
    let bytes = message.encode(&Written::Nothing, ByteOrder::Little, Time::default()).unwrap();
    serde_json::to_value(message.decode(&bytes).unwrap()).unwrap()
}

/// Are these the same value? Floating numbers of rosidl are texts, and a `float32` is the nearest one.
fn is_same(ours: &Value, theirs: &Value, is_single: bool) -> bool {
    let float = |text: &str| text.parse::<f64>().unwrap();
    let nearest = |value: f64| if is_single { f64::from(value as f32) } else { value };
    match (ours, theirs) {
        (Value::Array(ours), Value::Array(theirs)) => {
            ours.len() == theirs.len() && ours.iter().zip(theirs).all(|(a, b)| is_same(a, b, is_single))
        }
        (Value::Number(a), Value::String(b)) => nearest(a.as_f64().unwrap()).to_bits() == nearest(float(b)).to_bits(),
        (Value::String(a), Value::String(b)) => match a.as_str() {
            "NaN" => float(b).is_nan(),
            "Infinity" | "-Infinity" => float(a) == nearest(float(b)),
            _ => a == b,
        },
        (a, b) => a == b,
    }
}

#[test]
fn our_reader_agrees_with_rosidl_on_every_text() {
    /// Digits of other scripts, which Python reads, and we do not.
    const OTHER_DIGITS: &str = "int32 n \u{665}";
    /// Three characters of six bytes. CDR counts bytes, and so does a message that is written.
    const MANY_BYTES: &str = "string<=3 s ééé";
    let verdicts = Verdict::all();
    assert!(verdicts.len() > 600 && verdicts.iter().filter(|verdict| verdict.is_valid()).count() > 350);
    let mut wrong = Vec::new();
    let (mut values, mut hashes) = (0, 0);
    for verdict in &verdicts {
        let (text, line) = (&verdict.text, &verdict.line);
        let read = read(text);
        if text == OTHER_DIGITS {
            assert!(read.is_err());
            continue;
        }
        let message = match read {
            Ok(message) if verdict.is_valid() => message,
            Err(_) if !verdict.is_valid() => continue,
            Ok(_) => {
                wrong.push(format!("{text:?} is accepted; rosidl: {}", line["why"]));
                continue;
            }
            Err(fault) => {
                wrong.push(format!("{text:?} is rejected: {} (found {})", fault.message, fault.found));
                continue;
            }
        };
        if let Some(hash) = line["hash"].as_str() {
            hashes += 1;
            if message.type_hash() != hash {
                wrong.push(format!("{text:?} has another hash"));
            }
        }
        let theirs = line["values"].as_object().unwrap();
        if theirs.is_empty() || text == MANY_BYTES {
            continue;
        }
        let ours = defaults(&message);
        for (name, value) in theirs {
            values += 1;
            if !is_same(&ours[name], value, text.starts_with("float32")) {
                wrong.push(format!("{text:?}: {name} is {}; rosidl: {value}", ours[name]));
            }
        }
    }
    assert!(wrong.is_empty(), "{} of {} texts differ:\n{}", wrong.len(), verdicts.len(), wrong.join("\n"));
    assert!(values > 200 && hashes > 350, "{values} values and {hashes} hashes were compared");
}
