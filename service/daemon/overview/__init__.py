"""What an operator's page shows at a glance: state, lot, figures, alarms and newest stones in one document."""
