"""The frozen experiments of the evaluation suites, one YAML file each; evaluation.yaml holds their hashes."""
