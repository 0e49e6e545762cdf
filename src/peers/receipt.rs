//! Receipts between nodes.

use ledger_api::v1;
use ledger_raft::Receipt;

/// For the wire.
pub(crate) fn to_wire(Receipt { term, index, code }: Receipt) -> v1::Receipt {
    v1::Receipt { term, index, code }
}

/// From the wire. Only the node that is meant to have made it can check it.
pub(crate) fn from_wire(receipt: &v1::Receipt) -> Receipt {
    Receipt { term: receipt.term, index: receipt.index, code: receipt.code.clone() }
}
