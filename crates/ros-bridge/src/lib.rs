//! ros-bridge.
