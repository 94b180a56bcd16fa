"""Who answers where no person does."""
