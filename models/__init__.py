"""The robot: profiles, the loader, state types, frames and errors."""
