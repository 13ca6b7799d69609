"""The paper's tables and figures made again, from simulated runs with its own parameters."""
