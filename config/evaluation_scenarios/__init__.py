"""The frozen scenarios of the evaluation suites, one YAML file each; evaluation.yaml holds their hashes."""
