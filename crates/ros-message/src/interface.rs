//! Definitions of messages, services and actions. A service is several messages, and an action several services.
//!
//! ```text
//! my_msgs/srv/Open       Open_Request, Open_Response, Open_Event, and Open with these three
//! my_msgs/action/Go      Go_Goal, Go_Result, Go_Feedback, the services Go_SendGoal and Go_GetResult, Go_FeedbackMessage, and Go
//! ```

use crate::definition::{self, Count, FieldText, Kind, Primitive};
use crate::fault::Fault;
use crate::name;

/// Between the parts of a service or an action.
const NEXT_PART: &str = "---";

/// The definitions that a text makes for the type of this full name, the type itself among them.
///
/// # Errors
/// Names the first line that is not understood, or says that the text has too many parts or too few.
pub(crate) fn parse(full: &str, text: &str) -> Result<Vec<(String, Vec<FieldText>)>, Fault> {
    name::definable(full)?;
    let names: &[&str] = match full.split('/').nth(1) {
        Some("srv") => &["_Request", "_Response"],
        Some("action") => &["_Goal", "_Result", "_Feedback"],
        _ => return Ok(vec![(full.to_owned(), definition::parse(full, text)?)]),
    };
    let lines = definition::lines(text);
    let parts: Vec<_> = lines.split(|line| *line == NEXT_PART).collect();
    if parts.len() != names.len() {
        return Err(Fault::new(format!("the definition of {full} has the wrong number of parts"))
            .found(format!("{} lines of {NEXT_PART}", parts.len().saturating_sub(1)))
            .wanted(format!("{}", names.len().saturating_sub(1))));
    }
    let mut made = Vec::new();
    for (part, suffix) in parts.iter().zip(names) {
        let name = format!("{full}{suffix}");
        let fields = definition::parse(&name, &part.join("\n"))?;
        made.push((name, fields));
    }
    if names.len() == 2 {
        service(full, &mut made)
    } else {
        action(full, &mut made)
    }
    Ok(made)
}

/// Adds the types that a service has in addition to its request and its response.
fn service(full: &str, made: &mut Vec<(String, Vec<FieldText>)>) {
    let [request, response, event] = ["_Request", "_Response", "_Event"].map(|suffix| format!("{full}{suffix}"));
    let at_most_one = Count::Sequence(Some(1));
    made.push((
        event.clone(),
        vec![
            message("info", "service_msgs/msg/ServiceEventInfo"),
            FieldText { count: at_most_one, ..message("request", &request) },
            FieldText { count: at_most_one, ..message("response", &response) },
        ],
    ));
    made.push((
        full.to_owned(),
        vec![
            message("request_message", &request),
            message("response_message", &response),
            message("event_message", &event),
        ],
    ));
}

/// Adds the types that an action has in addition to its goal, its result and its feedback.
fn action(full: &str, made: &mut Vec<(String, Vec<FieldText>)>) {
    let of = |suffix: &str| format!("{full}{suffix}");
    let id = || message("goal_id", "unique_identifier_msgs/msg/UUID");
    let primitive = |name: &str, primitive| field(name, Kind::Primitive(primitive));
    made.push((of("_SendGoal_Request"), vec![id(), message("goal", &of("_Goal"))]));
    made.push((
        of("_SendGoal_Response"),
        vec![primitive("accepted", Primitive::Bool), message("stamp", "builtin_interfaces/msg/Time")],
    ));
    service(&of("_SendGoal"), made);
    made.push((of("_GetResult_Request"), vec![id()]));
    made.push((of("_GetResult_Response"), vec![primitive("status", Primitive::I8), message("result", &of("_Result"))]));
    service(&of("_GetResult"), made);
    made.push((of("_FeedbackMessage"), vec![id(), message("feedback", &of("_Feedback"))]));
    made.push((
        full.to_owned(),
        vec![
            message("goal", &of("_Goal")),
            message("result", &of("_Result")),
            message("feedback", &of("_Feedback")),
            message("send_goal_service", &of("_SendGoal")),
            message("get_result_service", &of("_GetResult")),
            message("feedback_message", &of("_FeedbackMessage")),
        ],
    ));
}

fn message(name: &str, of: &str) -> FieldText {
    field(name, Kind::Message(of.to_owned()))
}

fn field(name: &str, kind: Kind) -> FieldText {
    FieldText { name: name.to_owned(), kind, count: Count::One, default: None }
}
