//! Traces of messages, at a collector of OpenTelemetry.

use crate::support::wait::until;
use crate::world::{self, World};
use crate::{call, network};
use ledger_gate::sample::Sample;
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::common::v1::{KeyValue, any_value::Value};
use opentelemetry_proto::tonic::trace::v1::Span;
use ros_bridge::dds::Participant;
use ros_bridge::names::{TopicName, TypeName};
use ros_bridge::qos::Qos;
use ros_bridge::queue::Limits;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tonic::transport::Server;
use tonic::{Request, Response, Status};

const TWIST: &str = "geometry_msgs/msg/Twist";
const COLLECTOR: &str = "127.0.0.1:7470";

/// The steps that came, each with the program and the process that told it.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<(String, String, Span)>>>);

/// The text of an attribute.
fn text(attributes: &[KeyValue], name: &str) -> String {
    let found = attributes.iter().find(|fact| fact.key == name);
    match found.and_then(|fact| fact.value.as_ref()).and_then(|value| value.value.as_ref()) {
        Some(Value::StringValue(text)) => text.clone(),
        _ => String::new(),
    }
}

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        for of_one in request.into_inner().resource_spans {
            let names = of_one.resource.unwrap_or_default().attributes;
            let spans = of_one.scope_spans.into_iter().flat_map(|scope| scope.spans);
            let told = spans.map(|span| (text(&names, "service.name"), text(&names, "service.instance.id"), span));
            self.0.lock().unwrap().extend(told);
        }
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    /// Listens until the runtime is shut down, which ends its connections, too.
    fn listen(&self) -> Runtime {
        let service = TraceServiceServer::new(self.clone());
        let runtime = Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        runtime.spawn(async move {
            Server::builder().add_service(service).serve(COLLECTOR.parse().unwrap()).await.unwrap();
        });
        runtime
    }

    /// The steps of a message of which all steps have come, by process and name.
    fn whole(&self) -> Option<BTreeMap<String, Span>> {
        let told = self.0.lock().unwrap().clone();
        let ids = told.iter().filter(|(_, _, span)| span.name == "deliver").map(|(_, _, span)| span.trace_id.clone());
        ids.into_iter().find_map(|id| {
            let of_it = told.iter().filter(|(_, _, span)| span.trace_id == id);
            let steps: BTreeMap<String, Span> =
                of_it.map(|(program, who, span)| (format!("{program} {who} {}", span.name), span.clone())).collect();
            (steps.len() >= 6).then_some(steps)
        })
    }
}

fn traced(settings: &str) -> String {
    format!("{settings}\n[traces]\nendpoint = \"http://{COLLECTOR}\"\none_in = 1\n")
}

#[test]
fn one_message_has_one_trace_with_the_steps_of_all_processes_and_a_dead_collector_keeps_nothing_up() {
    if !network::isolated(&|| ()) {
        return;
    }
    world::run(async {
        let collector = Collector::default();
        let listening = collector.listen();
        let mut world = World::start_with_inner_bridge("/cmd_vel", TWIST).await;
        for (index, name) in ["Org1", "Org2"].into_iter().enumerate() {
            world.restart_node(index, name, |text| traced(&text));
        }
        let settings = traced("domain_id = 1\nshared_memory = false\nreport_s = 1");
        let salma =
            world.start_bridge_as("Salma", &format!("{settings}{}", world::route("to_ledger", "/cmd_vel", TWIST)), &[]);
        world.line("Salma", &["route 1: /cmd_vel -> Rover/cmd_vel"]).await;
        let (topic, kind) = (TopicName::parse("/cmd_vel").unwrap(), TypeName::parse(TWIST).unwrap());
        let graphs = [Participant::open(1, "teleop").await.unwrap(), Participant::open(3, "driver").await.unwrap()];
        let writer = graphs[0].writer(&topic, &kind, &Qos::default()).unwrap();
        let mut reader = graphs[1].reader(&topic, &kind, &Qos::default(), Limits::default()).unwrap();
        let drive = async || loop {
            writer.write(&Sample::new([0, 1], &[0; 48]).unwrap()).unwrap();
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        call(&world.salma, "acquire", &["Rover/cmd_vel", "120000"]).await;
        let test = async {
            let steps = until("a message has all its steps", || async { collector.whole() }).await;
            let expected = [
                "ledgerd Org1/node0 block",
                "ledgerd Org1/node0 gateway",
                "ledgerd Org2/node1 block",
                "ledgerd Org2/node1 deliver",
                "ledgerd-bridge Org1/Salma message",
                "ledgerd-bridge Org1/Salma submit",
            ];
            assert_eq!(steps.keys().collect::<Vec<_>>(), expected);
            let [ordered, gateway, applied, deliver, message, submit] = expected.map(|name| &steps[name]);
            // One begins after the other, and each takes its time. Block time is whole microseconds.
            for (before, after) in
                [(message, gateway), (submit, gateway), (gateway, deliver), (ordered, deliver), (applied, deliver)]
            {
                let (begun, later) = (before.start_time_unix_nano, after.start_time_unix_nano);
                assert!(begun <= later, "{before:?} {after:?}");
            }
            assert!(submit.end_time_unix_nano < deliver.end_time_unix_nano);
            assert!(gateway.start_time_unix_nano <= ordered.end_time_unix_nano);
            for span in steps.values() {
                assert!(span.start_time_unix_nano <= span.end_time_unix_nano, "{span:?}");
                assert!(
                    text(&span.attributes, "ledgerd.transaction").starts_with(&hex::encode(&span.trace_id)),
                    "{span:?}"
                );
                assert_eq!(
                    span.parent_span_id,
                    if span.name == "message" { Vec::new() } else { message.span_id.clone() }
                );
                assert!(span.status.is_none(), "{span:?}");
            }
            assert_eq!(text(&deliver.attributes, "ledgerd.service"), "Rover/cmd_vel");
            assert_eq!(text(&ordered.attributes, "ledgerd.height"), text(&applied.attributes, "ledgerd.height"));

            // The collector dies: messages go on as before.
            listening.shutdown_background();
            world.line("Salma", &["WARN", "the collector takes no steps of traces"]).await;
            while reader.try_next().is_some() {}
            for _ in 0..40 {
                reader.next().await.unwrap();
            }
            assert_eq!(world.said("Salma", "the collector takes no steps of traces"), 1, "it is said once");
            // It comes back, and hears of new ones.
            collector.0.lock().unwrap().clear();
            let listening = collector.listen();
            until("the collector hears of messages again", || async { collector.whole() }).await;
            listening.shutdown_background();
        };
        tokio::select! {
            () = drive() => {}
            () = test => {}
        }
        let report = salma.report();
        assert!(report["routes"][0]["committed"].as_u64() > Some(40), "{report}");
    });
}
