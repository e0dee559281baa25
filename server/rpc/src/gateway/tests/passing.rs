//! Tests of requests for the writer.

use super::*;

#[tokio::test]
async fn the_writer_does_what_a_follower_is_asked() {
    let (a, b) = Member::pair().await;
    let reply = a.add_state("door").await.expect("the writer takes it");
    assert_eq!(shown(reply.metadata()), token(&b.handle(), b.handle().shown()), "the writer has what it shows");
    assert_eq!(b.handle().view().len(), 1);
    assert_eq!(a.handle().view().len(), 0);
    let again = a.add_state("door/x").await.expect_err("no name of a state");
    assert_eq!(again.code(), Code::InvalidArgument, "{again:?}");
    b.add_state("window").await.expect("it is the writer itself");
    assert_eq!(b.handle().view().len(), 2);
}

#[tokio::test]
async fn what_was_passed_on_once_is_not_passed_on_again() {
    let (a, b) = Member::pair().await;
    b.notify(ReplicaEvent::Following { writer: Some("a".to_owned()) }).await;
    let refused = a.add_state("door").await.expect_err("each takes the other for the writer");
    assert_eq!(reason(&refused), (Code::Unavailable, "NOT_WRITER".to_owned()));
    assert!(refused.message().starts_with("a passed the request to this daemon"), "{refused:?}");
}

#[tokio::test]
async fn a_writer_that_is_not_known_or_away_is_waited_for() {
    let (a, b) = Member::pair().await;
    a.notify(ReplicaEvent::Following { writer: None }).await;
    let refused = a.add_state("door").await.expect_err("no writer");
    assert_eq!(reason(&refused), (Code::Unavailable, "NO_WRITER".to_owned()));
    // A port that nobody listens to.
    let free = TcpListener::bind("127.0.0.1:0").await.expect("a port").local_addr().expect("an address");
    a.knows("c", &format!("http://{free}"));
    a.notify(ReplicaEvent::Following { writer: Some("c".to_owned()) }).await;
    let refused = a.add_state("door").await.expect_err("nobody is there");
    assert_eq!(reason(&refused), (Code::Unavailable, "UNREACHABLE".to_owned()));
    let (added, ()) = tokio::join!(a.add_state("door"), async {
        // The request waits meanwhile.
        tokio::time::sleep(Duration::from_millis(50)).await;
        a.notify(ReplicaEvent::Following { writer: Some("b".to_owned()) }).await;
    });
    added.expect("the new writer takes it");
    assert_eq!(b.handle().view().len(), 1);
    a.notify(ReplicaEvent::Following { writer: None }).await;
    let (added, ()) = tokio::join!(a.add_state("window"), async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        a.notify(ReplicaEvent::Writing { epoch: 2 }).await;
    });
    added.expect("this daemon writes now");
    assert_eq!(a.handle().view().len(), 1);
}

#[tokio::test]
async fn a_map_that_is_not_held_is_asked_for_where_it_is() {
    let (_, b) = Member::pair().await;
    let c = Member::start("c").await;
    c.knows("b", &b.address);
    let refused = c.states(None).await.expect_err("no such map");
    assert_eq!(reason(&refused), (Code::NotFound, "UNKNOWN_MAP".to_owned()));
    c.known.writers.lock().expect("not poisoned").insert("office".to_owned(), "b".to_owned());
    c.add_state("door").await.expect("the writer takes it");
    assert_eq!(c.states(None).await.expect("the writer responds").0, ["door"]);
}

#[tokio::test]
async fn the_head_of_a_request_goes_with_it_and_ends_with_it() {
    let (a, _b) = Member::pair().await;
    let ((heads, mut heads_seen), (left, mut has_left)) = (mpsc::unbounded_channel(), mpsc::unbounded_channel());
    a.knows("b", &serve(Silent { heads, left }).await);
    let mut request = tonic::Request::new(new_state("door"));
    for (name, value) in
        [("authorization", "Bearer t"), ("traceparent", "00-1-2-01"), ("x-other", "1"), ("tidemap-allow-stale", "1")]
    {
        request.metadata_mut().insert(name, value.parse().expect("a value"));
    }
    request.set_timeout(Duration::from_millis(500));
    let late = a.maps().await.add_state(request).await.expect_err("no daemon responds");
    assert!(matches!(late.code(), Code::DeadlineExceeded | Code::Cancelled), "{late:?}");
    let head = heads_seen.recv().await.expect("it was passed on");
    for (name, value) in [
        ("authorization", "Bearer t"),
        ("traceparent", "00-1-2-01"),
        ("tidemap-allow-stale", "1"),
        ("tidemap-forwarded", "a"),
        ("grpc-timeout", "500000u"),
    ] {
        assert_eq!(head.get(name).map(HeaderValue::as_bytes), Some(value.as_bytes()), "{name}");
    }
    assert!(!head.contains_key("x-other"));
    has_left.recv().await.expect("the deadline is told");

    // A client that leaves.
    let mut client = a.maps().await;
    let asking = tokio::spawn(async move { client.add_state(new_state("door")).await });
    heads_seen.recv().await.expect("it was passed on");
    asking.abort();
    has_left.recv().await.expect("the writer receives it");
}

#[tokio::test]
async fn jobs_are_found_where_they_are() {
    let (a, b) = Member::pair().await;
    let run = v1::RunUpdateRequest { map: "office".to_owned(), ..v1::RunUpdateRequest::default() };
    let job = a.jobs().await.run_update(run).await.expect("the writer runs it").into_inner().job.expect("a job");
    assert!(b.catalog.context().jobs.get(job.id).is_some());
    let mut watched = a.jobs().await.watch_job(v1::WatchJobRequest { id: job.id }).await.expect("found").into_inner();
    let mut last = None;
    while let Some(reply) = watched.message().await.expect("a job") {
        last = reply.job;
    }
    assert_eq!(last.expect("the end").state(), v1::JobState::Done);
    let get = |id| v1::GetJobRequest { id };
    assert_eq!(a.jobs().await.get_job(get(job.id)).await.expect("found").into_inner().job.expect("it").id, job.id);
    let report = v1::GetUpdateReportRequest { job_id: job.id, ..v1::GetUpdateReportRequest::default() };
    a.jobs().await.get_update_report(report).await.expect("found");
    let unknown = a.jobs().await.get_job(get(7)).await.expect_err("nobody has it");
    assert_eq!(reason(&unknown), (Code::NotFound, "UNKNOWN_JOB".to_owned()));
    let free = TcpListener::bind("127.0.0.1:0").await.expect("a port").local_addr().expect("an address");
    a.knows("b", &format!("http://{free}"));
    let away = a.jobs().await.get_job(get(7)).await.expect_err("one may have it");
    assert_eq!(reason(&away), (Code::Unavailable, "UNREACHABLE".to_owned()));
}
