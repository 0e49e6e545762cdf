//! A ROS domain.

use ros_bridge::dds::DOMAIN_MAX;

/// Reads its number.
///
/// # Errors
/// The range that is wanted.
pub(crate) fn parse(text: &str) -> Result<u16, String> {
    let domain = text.parse().ok().filter(|domain| *domain <= DOMAIN_MAX);
    domain.ok_or_else(|| format!("wanted a ROS domain, 0 to {DOMAIN_MAX}"))
}
