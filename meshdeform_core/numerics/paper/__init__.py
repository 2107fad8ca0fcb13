"""What only the paper's tables need: `meshdeform reproduce` asks for it, no default does."""
