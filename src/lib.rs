//! ledgerd.

pub mod ca;
pub mod config;
pub mod enrolment;
pub mod setup;
pub mod waiters;

/// Stands for `listen.rs` until the client's TLS is there.
pub mod listen {
    /// Who is calling; the extension of every request.
    #[derive(Clone, Debug)]
    pub struct Caller {
        /// The verified identity; none for a client without a certificate, which can only enrol.
        pub identity: Option<std::sync::Arc<ledger::identity::Identity>>,
        /// Where the call comes from.
        pub address: std::net::SocketAddr,
    }
}
