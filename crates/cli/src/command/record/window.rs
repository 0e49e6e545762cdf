//! The blocks of a recording: from which on, and to which.

use super::selection::Selection;
use crate::argument::moment::{Instant, Moment};
use crate::session::{MSP, Session};
use crate::time;
use ledger_base::rejection::{Code, Rejection};

/// The blocks to record.
pub(super) struct Window {
    /// The first height.
    pub(super) first: u64,
    /// The last height, if it is known.
    pub(super) last: Option<u64>,
    /// The moment of the end, if it is yet to come: microseconds since the UNIX epoch.
    pub(super) ends_at: Option<u64>,
    /// Blocks whose time lies behind it are not recorded.
    latest: Option<u64>,
    /// It begins with the next block.
    pub(super) begins_now: bool,
}

impl Window {
    /// Finds the blocks of the moments that were typed.
    ///
    /// # Errors
    /// [`Code::BadArgument`] if it would be empty; [`Code::Pruned`] if the node has dropped its beginning.
    pub(super) async fn find(
        session: &Session,
        selection: &Selection,
        since: Option<Moment>,
        until: Option<Moment>,
        follow: bool,
    ) -> Result<Self, Rejection> {
        let (tip, now) = (selection.height, session.client.now());
        let mut window = Self { first: tip + 1, last: None, ends_at: None, latest: None, begins_now: since.is_none() };
        let blocks = Blocks { session, kept: session.client.status().await?.first_height.max(1), tip };
        match since.map(|since| since.seen_from(now)) {
            None => {}
            Some(Instant::Height(height)) => window.first = blocks.first_from(height, follow)?,
            Some(Instant::Time(at)) if at > now => return Err(ahead(at, now)),
            Some(Instant::Time(at)) => window.first = blocks.first_since(at, selection.time, now).await?,
        }
        match until.map(|until| until.seen_from(now)) {
            None => window.last = (since.is_some() && !follow).then_some(tip),
            Some(Instant::Height(height)) => window.last = Some(height),
            Some(Instant::Time(at)) if at > now => (window.ends_at, window.latest) = (Some(at), Some(at)),
            // Whatever is committed by now lies before it.
            Some(Instant::Time(at)) if at >= selection.time => window.last = Some(tip),
            Some(Instant::Time(at)) => window.last = Some(blocks.first_at(at.saturating_add(1)).await? - 1),
        }
        match window.last {
            // Nothing was committed since then: an empty recording, which is an answer as well.
            Some(last) if last < window.first && !(last == tip && since.is_some()) => Err(empty(&window, last)),
            _ => Ok(window),
        }
    }

    /// Is everything recorded, if `next` is the next height?
    pub(super) fn is_over(&self, next: u64) -> bool {
        self.last.is_some_and(|last| next > last || last < self.first)
    }

    /// Lies a block behind the end?
    pub(super) fn is_behind(&self, height: u64, time: u64) -> bool {
        self.last.is_some_and(|last| height > last) || self.latest.is_some_and(|latest| time > latest)
    }

    /// The moment of the end has come: whatever is committed by now is the rest.
    pub(super) async fn end_now(&mut self, session: &Session) -> Result<(), Rejection> {
        self.ends_at = None;
        self.last = Some(session.client.query(MSP, "rules", Vec::new()).await?.height);
        Ok(())
    }
}

/// The blocks of the node.
struct Blocks<'a> {
    session: &'a Session,
    /// The oldest one.
    kept: u64,
    /// The newest one.
    tip: u64,
}

impl Blocks<'_> {
    fn first_from(&self, height: u64, follow: bool) -> Result<u64, Rejection> {
        if height > self.tip && !follow {
            return Err(Rejection::new(Code::BadArgument, format!("block {height} does not exist yet"))
                .found(format!("the last block is {}", self.tip))
                .wanted("the height of a block, or a moment before now")
                .next("add --follow to wait for it"));
        }
        match height {
            0 => Ok(self.kept),
            height if height < self.kept => Err(self.dropped(format!("block {height}"))),
            height => Ok(height),
        }
    }

    /// The first block at or after a moment, which lies before now.
    async fn first_since(&self, at: u64, newest: u64, now: u64) -> Result<u64, Rejection> {
        if at > newest {
            return Ok(self.tip + 1);
        }
        if self.kept > 1 && at < self.time_of(self.kept).await? {
            return Err(self.dropped(format!("those of {}", time::relative(at, now))));
        }
        self.first_at(at).await
    }

    /// The first block whose time is not before this.
    async fn first_at(&self, at: u64) -> Result<u64, Rejection> {
        let (mut low, mut high) = (self.kept, self.tip + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            match self.time_of(middle).await? < at {
                true => low = middle + 1,
                false => high = middle,
            }
        }
        Ok(low)
    }

    async fn time_of(&self, height: u64) -> Result<u64, Rejection> {
        Ok(self.session.client.block(height).await?.time)
    }

    fn dropped(&self, wished: String) -> Rejection {
        Rejection::new(Code::Pruned, format!("this node has dropped old blocks, also {wished}"))
            .found(format!("blocks {} to {}", self.kept, self.tip))
            .wanted("a start that the node still has")
            .next("--since 0 for what it has, or a context with a node that keeps more")
    }
}

fn ahead(at: u64, now: u64) -> Rejection {
    Rejection::new(Code::BadArgument, "--since is in the future")
        .found(format!("{}, {}", time::moment(at), time::relative(at, now)))
        .wanted("a moment before now")
        .next("omit --since to record from now on")
}

fn empty(window: &Window, last: u64) -> Rejection {
    let next = match window.begins_now {
        true => "give --since: without it a recording begins now",
        false => "give a later --until, or none",
    };
    Rejection::new(Code::BadArgument, "the recording would end before it begins")
        .found(format!("a beginning with block {}, an end with block {last}", window.first))
        .wanted("--since before --until")
        .next(next)
}
