"""The paper's tables and figures, one command each: what to run (plans), running it (runner), and what came of it
beside the paper's own numbers (report, figures, paper)."""
