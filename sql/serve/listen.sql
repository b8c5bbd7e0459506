-- Purpose: be told when a map or its base layers change (see conetl.tell_news). No parameters, no columns.
listen conetl_news;
