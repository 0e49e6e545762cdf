//! A node: a host and its instance, up and down in order.

use super::bridge::NodeBridge;
use super::host::{Host, Services, Serving};
use super::instance::{Instance, Running};
use crate::clients::console::{Console, Parts};
use crate::clients::monitoring::{Admin, PageCredentials, WatchedNode};
use crate::process::config::Config;
use crate::process::failure::Ended;
use crate::process::failure::advised;
use crate::process::meters::Meters;
use crate::process::telemetry;
use crate::storage::Storage;
use crate::storage::files::{refuse_contradicted, refuse_restored};
use crate::trust::credentials::NodeCredentials;
use crate::trust::membership::nothing_here;
use crate::trust::renewal;
use ledger::{Chaincode, Ledger, Registry, Rules};
use ledger_abac::{AccessControl, Rule};
use ledger_api::tls::TlsIdentity;
use ledger_base::rejection::{Code, Rejection};
use ledger_storage::layout::GENESIS_FILE;
use ros_bridge::BridgeMonitor;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

/// Collects what a node consists of. The chaincodes `msp` and `abac` are always installed.
#[derive(Clone, Default)]
pub struct NodeBuilder {
    registry: Registry,
    faults: Vec<Rejection>,
    rules: Vec<Arc<dyn Rule>>,
    trusts_clock: bool,
}

impl NodeBuilder {
    /// Installs a chaincode. Every node of the network needs the same ones.
    #[must_use]
    pub fn chaincode(mut self, chaincode: impl Chaincode + 'static) -> Self {
        if let Err(fault) = self.registry.install(Arc::new(chaincode)) {
            self.faults.push(fault);
        }
        self
    }

    /// Installs a rule for who wins: owners choose it by its mode. Every node of the network needs the same ones.
    #[must_use]
    pub fn rule(mut self, rule: impl Rule + 'static) -> Self {
        self.rules.push(Arc::new(rule));
        self
    }

    /// The node speaks no newer rules of execution than these. Without this it speaks all that this release does.
    #[must_use]
    pub fn rules_up_to(mut self, newest: Rules) -> Self {
        self.registry.speak_up_to(newest);
        self
    }

    /// An operator says that the machine's clock is right, whatever block time is.
    #[must_use]
    pub fn trust_clock(mut self) -> Self {
        self.trusts_clock = true;
        self
    }

    /// The chaincodes that a node will have besides `msp`.
    ///
    /// # Errors
    /// If one of them cannot be installed.
    pub fn registry(&self) -> Result<Registry, Rejection> {
        if let Some(fault) = self.faults.first() {
            return Err(fault.clone());
        }
        let mut registry = self.registry.clone();
        let access = self.rules.iter().cloned().try_fold(AccessControl::new()?, AccessControl::with_rule)?;
        registry.install(Arc::new(access))?;
        Ok(registry)
    }

    /// Starts a node in the directory that the configuration names.
    ///
    /// # Errors
    /// The fault, in words for the operator.
    pub async fn start(&self, config: &Config) -> Result<Node, Rejection> {
        self.start_at(config, None).await.map_err(|reason| advised(reason, config))
    }

    /// Starts a node behind the listener of this host, beside the nodes of other networks that are there. The setting
    /// `listen` does not count.
    ///
    /// # Errors
    /// As [`NodeBuilder::start`]; [`Code::BadConfiguration`] if the host serves this network already.
    pub async fn start_on(&self, host: &Host, config: &Config) -> Result<Node, Rejection> {
        self.start_at(config, Some(host)).await.map_err(|reason| advised(reason, config))
    }

    async fn start_at(&self, config: &Config, host: Option<&Host>) -> Result<Node, Rejection> {
        Node::start((self.registry()?, self.trusts_clock), config, host).await
    }
}

/// A running node. Dropping it without [`Node::stop`] is like pulling the plug, which it survives. A process may hold several:
/// nodes of one network on hosts of their own, nodes of several networks behind one [`Host`], too.
pub struct Node {
    host: Host,
    instance: Running,
    /// Its certificate and key, shared with all that show them.
    identity: TlsIdentity,
    serving: Serving,
    bridge: Option<NodeBridge>,
    admin: Option<Admin>,
    console: Option<Console>,
}

impl Node {
    /// Collects what a node consists of.
    pub fn builder() -> NodeBuilder {
        NodeBuilder::default()
    }

    async fn start(
        (registry, trusts_clock): (Registry, bool),
        config: &Config,
        host: Option<&Host>,
    ) -> Result<Self, Rejection> {
        let started = Instant::now();
        let genesis = std::fs::read(config.data.join(GENESIS_FILE)).map_err(|error| nothing_here(config, &error))?;
        refuse_restored(config)?;
        refuse_contradicted(config)?;
        let meters = Meters::default();
        let storage = Storage::open(config, genesis, registry, &meters)?;
        let credentials = NodeCredentials::read(config)?;
        let host = match host {
            Some(host) => host.clone(),
            None => Host::listen(&config.listen).await?,
        };
        let host = if trusts_clock { host.trusting_its_clock() } else { host };
        let (instance, services) = Instance::build(&host, config, (storage, meters), credentials, started)?;
        let (identity, tracer) = (instance.trust.identity.clone(), instance.clients.tracer());
        let network = instance.ordering.storage.ledger.network();
        let sight = config.bridge.as_ref().map(|_| BridgeMonitor::default());
        let admin = admin(config, &identity, &services, sight.clone()).await?;
        let console = console(config, &host, &services).await?;
        let serving = host.serve(network, identity.clone(), services, &config.limits)?;
        let instance = match instance.begin(config.order.timing(), serving.stopping()).await {
            Ok(instance) => instance,
            Err(reason) => {
                serving.abort();
                return Err(reason);
            }
        };
        let (address, height) = (host.address(), instance.ordering.storage.ledger.tip().height);
        tracing::info!(%address, %network, height, "ready after {} ms", started.elapsed().as_millis());
        let settings = config.bridge.clone().zip(sight);
        let bridge = settings.map(|(settings, sight)| NodeBridge::start(settings, host.own_gateway(), (sight, tracer)));
        Ok(Self { host, instance, identity, serving, bridge, admin, console })
    }

    /// Takes over the level of the log and the routes of the bridge in another configuration, and a certificate of the node that lies in its
    /// data directory now. All other settings, and a bridge that comes or goes as a whole, count from the next start on.
    pub fn reload(&self, config: &Config) {
        telemetry::set_level(&config.log);
        match renewal::read_again(&config.data, &self.identity, &self.ledger().msps()) {
            Ok(true) => tracing::info!("using the new node certificate from the data directory"),
            Ok(false) => {}
            Err(fault) => {
                tracing::error!(code = fault.code.name(), reason = %fault, "new node certificate not usable; keeping \
                                                                            the current one")
            }
        }
        match (&self.bridge, &config.bridge) {
            (Some(bridge), Some(settings)) => bridge.reload(settings.clone()),
            (None, None) => {
                tracing::info!(
                    "no bridge on this node: changed settings other than level and certificate take effect \
                                at the next start"
                )
            }
            _ => tracing::warn!("adding or removing the bridge takes effect at the next start"),
        }
    }

    /// Where the node listens; the port is the real one where the configuration said 0.
    pub fn address(&self) -> SocketAddr {
        self.host.address()
    }

    /// Where the page for whoever watches the node is, if there is one.
    pub fn admin(&self) -> Option<SocketAddr> {
        self.admin.as_ref().map(Admin::address)
    }

    /// Where browsers find its console, such as `http://127.0.0.1:7452`, if there is one.
    pub fn console(&self) -> Option<&str> {
        self.console.as_ref().map(Console::address)
    }

    /// The ledger, for looking into it in the same process.
    pub fn ledger(&self) -> &Arc<Ledger> {
        &self.instance.ordering.storage.ledger
    }

    /// Waits until the node cannot go on as it is, and says why.
    pub async fn ended(&self) -> Ended {
        let mut ended = self.instance.ordering.failure.subscribe();
        match ended.wait_for(Option::is_some).await {
            Ok(reason) => reason.clone(),
            Err(_) => None,
        }
        .unwrap_or_else(|| Ended::Failed(Rejection::new(Code::Internal, "the node ended without a reason")))
    }

    /// Ends the node: the leadership goes to another voter, no new calls, the verdicts that are under way, then the
    /// stores.
    pub async fn stop(self) {
        if let Some(bridge) = self.bridge {
            bridge.stop().await;
        }
        self.instance.leave().await;
        self.serving.stop().await;
        self.host.leave().await;
        self.instance.stop().await;
    }
}

/// The page for whoever watches the node, if the configuration wants one.
async fn admin(
    config: &Config,
    identity: &TlsIdentity,
    services: &Services,
    bridge: Option<BridgeMonitor>,
) -> Result<Option<Admin>, Rejection> {
    if config.admin.is_empty() {
        return Ok(None);
    }
    let node = Arc::clone(&services.gateway.description);
    let papers = PageCredentials::OfNetwork(identity.clone(), Arc::clone(&services.trust));
    Admin::serve(&config.admin, Arc::new(WatchedNode { node, bridge }), papers).await.map(Some)
}

/// The console, if the configuration wants one; the node tells where it is.
async fn console(config: &Config, host: &Host, services: &Services) -> Result<Option<Console>, Rejection> {
    if config.console.listen.is_empty() {
        return Ok(None);
    }
    let parts = Parts {
        gateway: services.gateway.clone(),
        enrolment: services.enrolment.clone(),
        trust: Arc::clone(&services.trust),
    };
    let reached = match config.member.address.as_str() {
        "" => host.own_gateway(),
        address => address.to_owned(),
    };
    let console = Console::serve(&config.console, &reached, parts).await?;
    let _told_once = services.gateway.description.console.set(console.address().to_owned());
    Ok(Some(console))
}
