"""From rig logs to what the model of the rig lacks."""
