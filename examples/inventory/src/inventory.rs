//! The chaincode: what it is called, what it does, what it keeps.

use bytes::Bytes;
use ledger::{Chaincode, Context};
use ledger_base::rejection::{Code, Rejection};
use serde::{Deserialize, Serialize};

/// Name under which the chaincode is called.
pub(crate) const NAME: &str = "inventory";
/// Every function, for whoever mistypes one.
const FUNCTIONS: [&str; 4] = ["found", "collected", "item", "list"];
/// Longest name of an item, in bytes.
const ITEM_BYTES_MAX: usize = 64;
/// Farthest place from the origin of the map along an axis, in metres.
const DISTANCE_METRES_MAX: f64 = 100_000.0;
/// Most finds that lie around at once. `list` answers with all of them.
const FINDS_MAX: usize = 1000;

/// Key of [`Counts`].
const COUNTS_KEY: &[u8] = b"counts";
/// Keys of finds: this, then the number in 20 digits, so that they sort by it.
const FIND_KEYS: &[u8] = b"find/";

/// An inventory of what robots found.
///
/// | function | who | answer |
/// |---|---|---|
/// | `found ROBOT ITEM X Y` | anybody, for a robot that is registered | the [`Find`] |
/// | `collected ID` | the organisation that found it | the [`Find`], which is gone then |
/// | `item ID` | anybody | the [`Find`] |
/// | `list` | anybody | all [`Find`]s, oldest first |
///
/// Events: `found` and `collected` with the [`Find`], the item as subject.
pub(crate) struct Inventory;

/// Something that lies somewhere.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Find {
    /// Its number: finds are counted from 1.
    pub(crate) id: u64,
    /// Its name.
    pub(crate) item: String,
    /// The robot that found it.
    pub(crate) robot: String,
    /// Where on the fleet's map, in millimetres. Whole numbers read back as they were written; floats may not.
    pub(crate) x_mm: i64,
    /// Where on the fleet's map, in millimetres.
    pub(crate) y_mm: i64,
    /// The organisation that reported it.
    pub(crate) organisation: String,
    /// Its reporter, e.g. `Org1/Salma`.
    pub(crate) reported_by: String,
    /// When: block time, microseconds since the UNIX epoch.
    pub(crate) time: u64,
}

/// How many finds there are and were.
#[derive(Default, Serialize, Deserialize)]
struct Counts {
    /// How many lie around.
    present: usize,
    /// The number of the newest find.
    newest: u64,
}

impl Chaincode for Inventory {
    fn name(&self) -> &'static str {
        NAME
    }

    fn reads(&self) -> &'static [&'static str] {
        &["item", "list"]
    }

    fn invoke(&self, ctx: &mut Context<'_>, function: &str, args: &[Bytes]) -> Result<Bytes, Rejection> {
        match (function, args) {
            ("found", [robot, item, x, y]) => found(ctx, text("ROBOT", robot)?, item, (x, y)),
            ("collected", [id]) => collected(ctx, text("ID", id)?),
            ("item", [id]) => json(&find(ctx, text("ID", id)?)?),
            ("list", []) => list(ctx),
            ("found", _) => Err(wrong_count("found ROBOT ITEM X Y", args)),
            ("collected" | "item", _) => Err(wrong_count(&format!("{function} ID"), args)),
            ("list", _) => Err(wrong_count("list", args)),
            _ => Err(Rejection::unknown_function(NAME, function, &FUNCTIONS)),
        }
    }
}

/// `found ROBOT ITEM X Y`
fn found(ctx: &mut Context<'_>, robot: &str, item: &Bytes, place: (&Bytes, &Bytes)) -> Result<Bytes, Rejection> {
    let item = text("ITEM", item)?;
    if item.is_empty() || item.len() > ITEM_BYTES_MAX {
        return Err(bad_argument("ITEM", item, &format!("1 to {ITEM_BYTES_MAX} bytes")));
    }
    let (x_mm, y_mm) = (millimetres("X", place.0)?, millimetres("Y", place.1)?);
    // Another chaincode is asked as the same caller; its refusal, with its code and its words, becomes ours.
    ctx.call("abac", "robot", &[Bytes::copy_from_slice(robot.as_bytes())])?;
    let mut counts = counts(ctx)?;
    if counts.present >= FINDS_MAX {
        return Err(Rejection::new(Code::LimitExceeded, "the inventory is full")
            .found(format!("{} finds", counts.present))
            .wanted(format!("at most {FINDS_MAX}"))
            .next("collect some: ledgerctl invoke inventory collected ID"));
    }
    counts.present += 1;
    counts.newest += 1;
    let submitter = ctx.submitter()?;
    let find = Find {
        id: counts.newest,
        item: item.to_owned(),
        robot: robot.to_owned(),
        x_mm,
        y_mm,
        organisation: submitter.organisation.clone(),
        reported_by: submitter.id(),
        // Never the machine's clock: every node that executes this block must write the same.
        time: ctx.block_time(),
    };
    let response = json(&find)?;
    ctx.put(COUNTS_KEY, json(&counts)?);
    ctx.put(&find_key(find.id), response.clone());
    ctx.emit("found", item, response.clone());
    Ok(response)
}

/// `collected ID`
fn collected(ctx: &mut Context<'_>, id: &str) -> Result<Bytes, Rejection> {
    let find = find(ctx, id)?;
    let submitter = ctx.submitter()?;
    if submitter.organisation != find.organisation {
        return Err(Rejection::new(Code::Refused, format!("{} belongs to who found it", find.item))
            .found(submitter.id())
            .wanted(format!("somebody of {}", find.organisation))
            .next(format!("ask {}", find.reported_by)));
    }
    let mut counts = counts(ctx)?;
    counts.present = counts.present.saturating_sub(1);
    let response = json(&find)?;
    ctx.put(COUNTS_KEY, json(&counts)?);
    ctx.delete(&find_key(find.id));
    ctx.emit("collected", &find.item, response.clone());
    Ok(response)
}

/// `list`
fn list(ctx: &Context<'_>) -> Result<Bytes, Rejection> {
    let finds: Vec<Find> =
        ctx.range(FIND_KEYS, FINDS_MAX).iter().map(|(_, value)| stored(value)).collect::<Result<_, _>>()?;
    json(&finds)
}

fn find(ctx: &Context<'_>, id: &str) -> Result<Find, Rejection> {
    let number = id.parse().map_err(|_| bad_argument("ID", id, "the number of a find"))?;
    let value = ctx.get(&find_key(number)).ok_or_else(|| {
        Rejection::new(Code::NotFound, format!("there is no find {number}"))
            .next("ledgerctl query inventory list shows those there are")
    })?;
    stored(&value)
}

fn counts(ctx: &Context<'_>) -> Result<Counts, Rejection> {
    ctx.get(COUNTS_KEY).map_or_else(|| Ok(Counts::default()), |value| stored(&value))
}

fn find_key(id: u64) -> Vec<u8> {
    [FIND_KEYS, format!("{id:020}").as_bytes()].concat()
}

fn json(value: &impl Serialize) -> Result<Bytes, Rejection> {
    serde_json::to_vec(value).map(Bytes::from).map_err(|error| Rejection::new(Code::Internal, error.to_string()))
}

/// The value that this chaincode wrote earlier.
fn stored<T: for<'a> Deserialize<'a>>(value: &[u8]) -> Result<T, Rejection> {
    serde_json::from_slice(value)
        .map_err(|error| Rejection::new(Code::Corrupt, format!("a stored value cannot be read: {error}")))
}

fn text<'a>(name: &str, argument: &'a Bytes) -> Result<&'a str, Rejection> {
    std::str::from_utf8(argument).map_err(|_| bad_argument(name, &format!("{} bytes", argument.len()), "text in UTF-8"))
}

/// A distance in metres, as text, to the nearest millimetre.
fn millimetres(name: &str, argument: &Bytes) -> Result<i64, Rejection> {
    let text = text(name, argument)?;
    let metres: Option<f64> = text.parse().ok();
    metres
        .filter(|metres| metres.abs() <= DISTANCE_METRES_MAX)
        .map(|metres| (metres * 1000.0).round() as i64)
        .ok_or_else(|| bad_argument(name, text, &format!("metres, -{DISTANCE_METRES_MAX} to {DISTANCE_METRES_MAX}")))
}

fn wrong_count(usage: &str, args: &[Bytes]) -> Rejection {
    Rejection::new(Code::BadArgument, "wrong number of arguments")
        .found(args.len().to_string())
        .wanted(usage)
        .next(format!("ledgerctl invoke {NAME} {usage}"))
}

fn bad_argument(name: &str, found: &str, wanted: &str) -> Rejection {
    Rejection::new(Code::BadArgument, format!("argument {name} is not usable"))
        .found(format!("{found:?}"))
        .wanted(wanted)
}

#[cfg(test)]
mod tests;
