"""On-line estimation of motors, valves and sensors."""
