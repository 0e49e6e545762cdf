//! Phrases that a reader stops at, each with the better words.
//!
//! A pattern is a sequence of words. Commas, colons and full stops end a match. Text in backquotes does not count.
//!
//! | in a pattern | matches |
//! |---|---|
//! | `a\|b` | one of these words |
//! | `a*` | a word with this beginning |
//! | `#` | a number |
//! | `$machine` | a part of the system |
//! | `^ …` | at the begin of a sentence only |
//! | `!a …` | except after this word |

/// A phrase with the words that replace it.
pub(crate) struct Rule {
    pub(crate) pattern: &'static str,
    pub(crate) instead: &'static str,
    /// A sentence that the rule rejects, and the same one in better words.
    pub(crate) examples: [&'static str; 2],
}

/// A rule: pattern, better words, a rejected sentence, a better one.
const fn rule(pattern: &'static str, instead: &'static str, rejected: &'static str, better: &'static str) -> Rule {
    Rule { pattern, instead, examples: [rejected, better] }
}

/// The words that `$machine` stands for.
pub(crate) const MACHINES: &str = "node|nodes|robot|robots|gate|gates|bridge|bridges|ledger|network|networks|voter|voters|learner|\
    learners|leader|leaders|follower|followers|client|clients|server|servers|program|programs|process|processes|peer|peers|browser|\
    browsers|console|machine|machines|engine|replica|task|thread|threads|gateway|cli|ledgerctl|ledgerd|parser|kernel|disk";

pub(crate) const RULES: &[Rule] = &[
    // Verbs of people for machines.
    rule("believ*|disbeliev*", "trusts, accepts, assumes", "The gate believes no node.", "The gate trusts no node."),
    rule("hear|hears|heard|unheard", "receives, is received", "A bridge hears it.", "A bridge receives it."),
    rule(
        "tell|tells|told|telling|untold",
        "reports, logs, sends, notifies, distinguishes",
        "The node is told the height.",
        "The node receives the height.",
    ),
    rule(
        "$machine say|says|said|know|knows|knew|learn|learns|learned|learnt|meet|meets|met|think|thinks|speak|speaks",
        "reports, stores, has, receives, fails with, supports",
        "Each node knows the members.",
        "Each node stores the members.",
    ),
    rule(
        "$machine want|wants|wanted|wish|wishes|promise|promises|forget|forgets|forgot",
        "requests, requires, guarantees, deletes",
        "The node forgets the id.",
        "The node deletes the id.",
    ),
    rule(
        "$machine takes|take|took no",
        "rejects, accepts none",
        "The ledger takes no report.",
        "The ledger rejects the report.",
    ),
    rule(
        "stand|stands|stood|standing in|at|for|there|on|between|behind|before|above|below|beside|still|alone|by|as|first|last",
        "is, is in, means, is stored in",
        "Transactions stand in blocks.",
        "Transactions are stored in blocks.",
    ),
    rule("as it|they stands|stand", "unchanged", "The file is sent as it stands.", "The file is sent unchanged."),
    rule("go|goes|going|went|gone on", "continues, resumes", "The bridge goes on.", "The bridge continues."),
    rule("go|goes|going|went by itself|themselves", "is automatic", "Renewal goes by itself.", "Renewal is automatic."),
    rule(
        "come|comes|came|coming back|late|again|too|anew",
        "returns, reconnects, arrives late",
        "The robot comes back.",
        "The robot reconnects.",
    ),
    rule("let|lets|letting in", "accepts", "Clients are let in.", "Clients are accepted."),
    rule("sign|signs of life", "heartbeats", "It sends signs of life.", "It sends heartbeats."),
    rule("last word", "the final say", "The gate has the last word.", "The gate has the final say."),
    // Roles without a name, and clauses in place of a noun.
    rule(
        "nobody|somebody|everybody|anybody",
        "the role: unauthenticated client, member, admin, operator, no client",
        "Nobody holds the service.",
        "No client holds the service.",
    ),
    rule(
        "whoever|whomever|whosoever|whatever",
        "a noun: the holder, the sender, each value",
        "It is for whoever watches a node.",
        "It is for monitoring.",
    ),
    rule(
        "those|he|ones|one who",
        "a noun: members, readers, contenders",
        "It lists those who wait.",
        "It lists the contenders.",
    ),
    rule("^ those that|which", "a noun first", "Those that wait are listed.", "Contenders are listed."),
    rule(
        "of|for|from|by|with|than|beyond|behind|except|besides what",
        "a noun: the content, the request, the blocks",
        "The hash of what was sent.",
        "The hash of the request.",
    ),
    // Amounts.
    rule("so many|much", "N, at most N, this number", "It sends so many bytes.", "It sends N bytes."),
    rule("as many as", "at most N, up to", "As many as ten wait.", "At most ten wait."),
    rule("twentieth|fiftieth|hundredth|thousandth", "5 %, 2 %, 1 %, 0.1 %", "A fiftieth is lost.", "2 % is lost."),
    rule("# of 100|1000", "a percentage, or p99", "99 of 100 arrive.", "99 % arrive."),
    // Words from German.
    rule("anew", "again", "It makes the state anew.", "It rebuilds the state."),
    rule("forever", "permanently", "It is kept forever.", "It is stored permanently."),
    rule("for ever", "permanently", "It is kept for ever.", "It is stored permanently."),
    rule("for good", "permanently", "The grant ends for good.", "The grant ends permanently."),
    rule(
        "beside|besides",
        "next to, in addition to, outside of",
        "It runs beside the node.",
        "It runs next to the node.",
    ),
    rule("$machine|it|they|which|that has|have to", "must, needs to", "The node has to stop.", "The node must stop."),
    rule(
        "is|are|was|were none of",
        "is not a member of, does not belong to",
        "The node is none of ours.",
        "The node is not a member.",
    ),
    rule("any more", "no longer", "It does not wait any more.", "It no longer waits."),
    rule("nowhere any|more", "in no", "It waits nowhere any more.", "It was removed from every queue."),
    rule("is|are to be", "must be, will be", "The file is to be signed.", "The file must be signed."),
    // Terms of the product.
    rule(
        "wait|waits|waiting|place|places|stand|stands|first|next|go|goes in line",
        "in the queue, position in the queue",
        "Farhad waits in line.",
        "Farhad waits in the queue.",
    ),
    rule("side door|doors", "rogue publisher", "It is a side door.", "It is a rogue publisher."),
    rule(
        "stranger|strangers",
        "unauthenticated client, rogue publisher",
        "A stranger calls.",
        "An unauthenticated client calls.",
    ),
    rule(
        "refus*",
        "rejects, rejection (denied for a decision of policies)",
        "The node refuses the call.",
        "The node rejects the call.",
    ),
    rule(
        "!quorum certificate|certificates of a|the|this|its block|blocks",
        "quorum certificate",
        "The certificate of a block is stored.",
        "The quorum certificate is stored.",
    ),
    rule(
        "carry|carries|carried the ca",
        "holds the CA key",
        "This node carries the CA.",
        "This node holds the CA key.",
    ),
    rule("yours alone", "acquired (exclusive)", "The robot is yours alone.", "The robot is acquired (exclusive)."),
    rule("shall be", "must be, target", "It shall be stopped.", "It must be stopped."),
    rule(
        "jury|juries|crowd|crowds|papers",
        "confirmers, connections, credentials",
        "The jury decides.",
        "The confirmers decide.",
    ),
    // Advertising.
    rule(
        "seamless*|effortless*|blazing*|cutting-edge|world-class|revolutionary|lightning-fast|battle-tested",
        "a measured value, or nothing",
        "It integrates seamlessly.",
        "It integrates.",
    ),
];

/// Headings are noun phrases that a search finds; these words begin a clause.
pub(crate) const NO_HEADINGS: &str = "what|who|whoever|whose|whom|it|they|those|that|this|he|she";
