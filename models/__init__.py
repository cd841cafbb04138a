"""Robot description: profiles, model loader, state types, frames and errors."""
