; The pipeline has not been found yet; it shall be found and inspected.
(define (problem inspect_the_pipeline)
  (:domain suave)

  (:objects
    search_pipeline inspect_pipeline - action
    pipeline - pipeline
    bluerov - robot
  )

  ; (action_feasible ...) is left out: it is asked of the knowledge base whenever a plan is made.
  (:init
    (search_pipeline_action search_pipeline)
    (inspect_pipeline_action inspect_pipeline)
  )

  (:goal (and
    (pipeline_inspected pipeline)
  ))
)
