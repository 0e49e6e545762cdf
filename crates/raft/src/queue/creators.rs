//! The organisations of those whose transactions wait.

use ledger_base::hash::Hash;
use std::fmt;
use std::sync::Arc;

/// Finds the organisation of a creator, by the hash of the creator's certificate. The default finds none.
#[derive(Clone, Default)]
pub struct Creators(Option<Arc<Find>>);

type Find = dyn Fn(&Hash) -> Option<Hash> + Send + Sync;

impl Creators {
    /// `find` answers with the hash of the organisation's name, if the creator is known. It is called for each transaction, so
    /// it must be fast.
    pub fn new(find: impl Fn(&Hash) -> Option<Hash> + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(find)))
    }

    /// The organisation of a creator. All unknown creators are of one organisation, so that inventing them gives nothing. Where
    /// none can be known, each creator is an organisation of its own.
    pub(super) fn organisation(&self, creator: &Hash) -> Hash {
        match &self.0 {
            Some(find) => find(creator).unwrap_or_default(),
            None => *creator,
        }
    }
}

impl fmt::Debug for Creators {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Creators")
    }
}
