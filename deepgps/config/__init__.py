"""What decides a run: the scenario, the settings of learning, the table of methods. Nothing heavy is imported."""
