"""How blocks meet: interfaces, declared connections, openings between them, overset components."""
