"""What the robot is: profiles, the loader, state types, frames and errors."""
